//! Unix times as dates.

/// 1980-01-01. No recording is older: an earlier time has another epoch.
const FIRST_DATE_S: f64 = 315_532_800.0;

/// Date, hour, minute and second of a Unix time in whole seconds, UTC.
fn civil(unix_s: i64) -> (String, i64, i64, i64) {
    let (days, second) = (unix_s.div_euclid(86_400), unix_s.rem_euclid(86_400));
    let (year, month, day) = geu_protocol::calendar::date(days);
    (format!("{year:04}-{month:02}-{day:02}"), second / 3600, second / 60 % 60, second % 60)
}

/// A Unix time as a date, to the second; a time with another epoch in seconds.
pub(crate) fn date(unix_s: f64) -> String {
    if unix_s < FIRST_DATE_S {
        return format!("{} s, date unknown", format!("{unix_s:.1}").replace('-', "−"));
    }
    let (date, hour, minute, second) = civil(unix_s.floor() as i64);
    format!("{date} {hour:02}:{minute:02}:{second:02} UTC")
}

/// A Unix time rounded to the minute.
pub(crate) fn utc(unix_s: f64) -> String {
    let (date, hour, minute, _) = civil((unix_s / 60.0).round() as i64 * 60);
    format!("{date} {hour:02}:{minute:02} UTC")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_those_of_date() {
        // `date -u -d @1795230720` and so on.
        for (unix_s, text) in [
            (0.0, "0.0 s, date unknown"),
            (86_400.5, "86400.5 s, date unknown"),
            (-1.0, "−1.0 s, date unknown"),
            (315_532_800.0, "1980-01-01 00:00:00 UTC"),
            (951_782_399.5, "2000-02-28 23:59:59 UTC"),
            (951_782_400.0, "2000-02-29 00:00:00 UTC"),
            (1_795_230_720.0, "2026-11-21 03:12:00 UTC"),
        ] {
            assert_eq!(date(unix_s), text);
        }
        for (unix_s, text) in [
            (0.0, "1970-01-01 00:00 UTC"),
            (951_782_400.0, "2000-02-29 00:00 UTC"),
            (1_800_000_000.0, "2027-01-15 08:00 UTC"),
            (-60.0, "1969-12-31 23:59 UTC"),
        ] {
            assert_eq!(utc(unix_s), text);
        }
    }
}

//! What `geu track` writes of a sample.

use std::fmt::Write as _;

use geu_calibration::Track;
use geu_calibration::redundancy::{ParityResidual, ParityTest, WINDOW_S};
use geu_calibration::track::in_use_name;

use super::{quote, write_seconds};

/// How tracks are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TrackFormat {
    Csv,
    Jsonl,
    /// A line to read, in arcsec.
    Text,
}

/// A difference of the redundant pair with its sigma.
pub fn track_difference(difference: ParityResidual) -> String {
    format!("{:+.2}″ ± {:.2}″", difference.arcsec, difference.sigma_arcsec)
}

/// The time of a sample, else its sequence.
pub fn instant(track: &Track) -> String {
    match track.time {
        Some(time) => {
            let mut bytes = Vec::new();
            write_seconds(time, &mut bytes);
            format!("{} s", String::from_utf8_lossy(&bytes))
        }
        None => format!("sequence {}", track.sample.sequence),
    }
}

/// Columns, in order.
pub const TRACK_COLUMNS: [&str; 22] = [
    "t_s",
    "sequence",
    "increment_x_arcsec",
    "increment_y_arcsec",
    "increment_z_arcsec",
    "angle_x_arcsec",
    "angle_y_arcsec",
    "angle_z_arcsec",
    "q_w",
    "q_x",
    "q_y",
    "q_z",
    "valid",
    "lost_half_seconds",
    "redundancy_arcsec",
    "redundancy_sigma_arcsec",
    "redundancy_rate_arcsec_per_h",
    "redundancy_rate_sigma_arcsec_per_h",
    "gyros",
    "gyro_flags",
    "unit_flags",
    "notes",
];
/// Columns that hold words.
const WORDS: [&str; 2] = ["gyros", "notes"];

/// What stands in the columns of a row; nothing where it is not known.
fn cells(track: &Track) -> [Option<String>; TRACK_COLUMNS.len()] {
    let mut t_s = Vec::new();
    if let Some(time) = track.time {
        write_seconds(time, &mut t_s);
    }
    let angle = |arcsec: f64| format!("{arcsec:.6}");
    let [ix, iy, iz] = match track.increment_control_arcsec {
        Some(increment) => increment.map(|arcsec| Some(angle(arcsec))),
        None => [None, None, None],
    };
    let [ax, ay, az] = track.angle_control_arcsec.map(|arcsec| Some(angle(arcsec)));
    let [qx, qy, qz, qw] = <[f64; 4]>::from(track.attitude.coords).map(|part| Some(format!("{part:.12}")));
    let accumulated = track.redundancy.map(|checked| checked.accumulated);
    let window = track.redundancy.and_then(|checked| checked.window);
    let per_h = |arcsec: f64| format!("{:.3}", arcsec * (3600.0 / WINDOW_S));
    let sample = &track.sample;
    [
        track.time.map(|_| String::from_utf8_lossy(&t_s).into_owned()),
        Some(sample.sequence.to_string()),
        ix,
        iy,
        iz,
        ax,
        ay,
        az,
        qw,
        qx,
        qy,
        qz,
        Some(u8::from(track.is_complete).to_string()),
        Some(track.lost_samples.to_string()),
        accumulated.map(|difference| angle(difference.arcsec)),
        accumulated.map(|difference| angle(difference.sigma_arcsec)),
        window.map(|difference| per_h(difference.arcsec)),
        window.map(|difference| per_h(difference.sigma_arcsec)),
        track.in_use.map(|in_use| in_use_name(in_use).to_owned()),
        Some(sample.gyro_flags.to_string()),
        Some(sample.unit_flags.to_string()),
        Some(notes(track)).filter(|notes| !notes.is_empty()),
    ]
}

/// What is to be known of a sample, in words without a comma.
fn notes(track: &Track) -> String {
    let mut notes: Vec<String> = track.reasons.iter().map(ToString::to_string).collect();
    if let Some(checked) = &track.redundancy {
        for (test, is_alarmed) in [ParityTest::Window, ParityTest::Start].into_iter().zip(checked.is_alarmed) {
            notes.extend(is_alarmed.then(|| format!("GYRZA and GYRZB differ {test}")));
        }
    }
    notes.join("; ")
}

fn text_line(track: &Track) -> String {
    let q = track.attitude;
    let mut line = instant(track);
    match track.increment_control_arcsec {
        Some([x, y, z]) => _ = write!(line, "  Δ {x:+9.3} {y:+9.3} {z:+9.3}"),
        None => line += "  Δ         –         –         –",
    }
    let _ = write!(line, "  q {:+.7} {:+.7} {:+.7} {:+.7}", q.w, q.i, q.j, q.k);
    if let Some(checked) = &track.redundancy {
        let _ = write!(line, "  ZA−ZB {}", track_difference(checked.accumulated));
    }
    let notes = notes(track);
    if !track.is_complete {
        let _ = write!(line, "  {} lost", track.lost_samples);
    }
    if !notes.is_empty() {
        let _ = write!(line, "  {notes}");
    }
    line
}

/// Appends a track with its line end.
pub fn write_track(format: TrackFormat, track: &Track, out: &mut Vec<u8>) {
    match format {
        TrackFormat::Text => out.extend_from_slice(text_line(track).as_bytes()),
        TrackFormat::Csv => {
            let cells = cells(track).map(Option::unwrap_or_default);
            out.extend_from_slice(cells.join(",").as_bytes());
        }
        TrackFormat::Jsonl => {
            for (index, (name, cell)) in TRACK_COLUMNS.iter().zip(cells(track)).enumerate() {
                out.push(if index == 0 { b'{' } else { b',' });
                quote(name, out);
                out.push(b':');
                match cell {
                    Some(words) if WORDS.contains(name) => quote(&words, out),
                    Some(number) => out.extend_from_slice(number.as_bytes()),
                    None => out.extend_from_slice(b"null"),
                }
            }
            out.push(b'}');
        }
    }
    out.push(b'\n');
}

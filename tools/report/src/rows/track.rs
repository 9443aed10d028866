//! Output of `geu track`.

use std::fmt::Write as _;

use geu_calibration::Track;
use geu_calibration::parity::{ParityResidual, ParityTest, WINDOW_S};
use geu_calibration::track::gyro_set_name;

use super::quote;

/// Formats of tracks.
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
        Some(time) => format!("{time} s"),
        None => format!("sequence {}", track.sample.sequence),
    }
}

/// A column: name, and cell of a sample, `None` if it is unknown.
type Column = (&'static str, fn(&Track) -> Option<String>);

/// Columns of the default unit, in order, before and after [`TURNED`].
const FIRST: [Column; 2] = [
    ("t_s", |track| track.time.map(|time| time.to_string())),
    ("sequence", |track| Some(track.sample.sequence.to_string())),
];
const LAST: [Column; 9] = [
    ("lost_half_seconds", |track| Some(track.lost_samples.to_string())),
    ("redundancy_arcsec", |track| track.parity.map(|parity| angle(parity.accumulated.arcsec))),
    ("redundancy_sigma_arcsec", |track| track.parity.map(|parity| angle(parity.accumulated.sigma_arcsec))),
    ("redundancy_rate_arcsec_per_h", |track| Some(per_h(track.parity?.window?.arcsec))),
    ("redundancy_rate_sigma_arcsec_per_h", |track| Some(per_h(track.parity?.window?.sigma_arcsec))),
    ("gyros", |track| track.in_use.map(|in_use| gyro_set_name(in_use).to_owned())),
    ("gyro_flags", |track| Some(track.sample.gyro_flags.to_string())),
    ("unit_flags", |track| Some(track.sample.unit_flags.to_string())),
    NOTES,
];
/// Columns of a described unit, the same.
const DESCRIBED_FIRST: [Column; 2] = [FIRST[0], ("number", |track| track.number.map(|number| number.to_string()))];
const DESCRIBED_LAST: [Column; 5] = [
    ("lost_samples", LAST[0].1),
    ("redundancy_arcsec", |track| track.residual.map(|(_, arcsec)| angle(arcsec))),
    ("redundancy_head", |track| track.residual.map(|(head, _)| head.to_owned())),
    ("heads", |track| track.heads.map(|heads| heads.names().join(" "))),
    NOTES,
];
const NOTES: Column = ("notes", |track| Some(notes(track)).filter(|notes| !notes.is_empty()));
/// Columns of every unit.
const TURNED: [Column; 11] = [
    ("increment_x_arcsec", |track| track.increment_control_arcsec.map(|[x, _, _]| angle(x))),
    ("increment_y_arcsec", |track| track.increment_control_arcsec.map(|[_, y, _]| angle(y))),
    ("increment_z_arcsec", |track| track.increment_control_arcsec.map(|[_, _, z]| angle(z))),
    ("angle_x_arcsec", |track| Some(angle(track.angle_control_arcsec[0]))),
    ("angle_y_arcsec", |track| Some(angle(track.angle_control_arcsec[1]))),
    ("angle_z_arcsec", |track| Some(angle(track.angle_control_arcsec[2]))),
    ("q_w", |track| Some(format!("{:.12}", track.attitude.w))),
    ("q_x", |track| Some(format!("{:.12}", track.attitude.i))),
    ("q_y", |track| Some(format!("{:.12}", track.attitude.j))),
    ("q_z", |track| Some(format!("{:.12}", track.attitude.k))),
    ("valid", |track| Some(u8::from(track.is_complete).to_string())),
];
/// Columns that hold text.
const TEXTS: [&str; 4] = ["gyros", "redundancy_head", "heads", "notes"];

fn columns(is_described: bool) -> impl Iterator<Item = Column> {
    let (first, last): (_, &[Column]) = if is_described { (DESCRIBED_FIRST, &DESCRIBED_LAST) } else { (FIRST, &LAST) };
    first.into_iter().chain(TURNED).chain(last.iter().copied())
}

/// The header of CSV.
pub fn track_header(is_described: bool) -> String {
    columns(is_described).map(|(name, _)| name).collect::<Vec<_>>().join(",") + "\n"
}

fn angle(arcsec: f64) -> String {
    format!("{arcsec:.6}")
}

fn per_h(arcsec: f64) -> String {
    format!("{:.3}", arcsec * (3600.0 / WINDOW_S))
}

/// Notes on a sample, without commas.
fn notes(track: &Track) -> String {
    let mut notes: Vec<String> = track.reasons.iter().map(ToString::to_string).collect();
    if let Some(checked) = &track.parity {
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
    if let Some(checked) = &track.parity {
        let _ = write!(line, "  ZA−ZB {}", track_difference(checked.accumulated));
    }
    if let Some((head, arcsec)) = track.residual {
        let _ = write!(line, "  {head} {arcsec:+.2}″");
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
            let cells = columns(track.number.is_some()).map(|(_, cell)| cell(track).unwrap_or_default());
            out.extend_from_slice(cells.collect::<Vec<_>>().join(",").as_bytes());
        }
        TrackFormat::Jsonl => {
            for (index, (name, cell)) in columns(track.number.is_some()).enumerate() {
                out.push(if index == 0 { b'{' } else { b',' });
                quote(name, out);
                out.push(b':');
                match cell(track) {
                    Some(text) if TEXTS.contains(&name) => quote(&text, out),
                    Some(number) => out.extend_from_slice(number.as_bytes()),
                    None => out.extend_from_slice(b"null"),
                }
            }
            out.push(b'}');
        }
    }
    out.push(b'\n');
}

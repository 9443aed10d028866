//! Output of `geu track`.

use std::fmt::Write as _;

use geu_calibration::Track;
use geu_calibration::parity::{ParityResidual, ParityTest, WINDOW_S};
use geu_calibration::track::gyro_set_name;
use geu_recording::archive::ColumnKind::{self, Flag, Real, Text, Whole};

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

/// A column: name, content, and cell of a sample, `None` if it is unknown.
pub type TrackColumn = (&'static str, ColumnKind, fn(&Track) -> Option<String>);

/// Columns of the default unit, in order, before and after [`TURNED`].
const FIRST: [TrackColumn; 2] = [
    ("t_s", Real, |track| track.time.map(|time| time.to_string())),
    ("sequence", Whole, |track| Some(track.sample.sequence.to_string())),
];
const LAST: [TrackColumn; 9] = [
    ("lost_half_seconds", Whole, |track| Some(track.lost_samples.to_string())),
    ("redundancy_arcsec", Real, |track| track.parity.map(|parity| angle(parity.accumulated.arcsec))),
    ("redundancy_sigma_arcsec", Real, |track| track.parity.map(|parity| angle(parity.accumulated.sigma_arcsec))),
    ("redundancy_rate_arcsec_per_h", Real, |track| Some(per_h(track.parity?.window?.arcsec))),
    ("redundancy_rate_sigma_arcsec_per_h", Real, |track| Some(per_h(track.parity?.window?.sigma_arcsec))),
    ("gyros", Text, |track| track.in_use.map(|in_use| gyro_set_name(in_use).to_owned())),
    ("gyro_flags", Whole, |track| Some(track.sample.gyro_flags.to_string())),
    ("unit_flags", Whole, |track| Some(track.sample.unit_flags.to_string())),
    NOTES,
];
/// Columns of a described unit, the same.
const DESCRIBED_FIRST: [TrackColumn; 2] =
    [FIRST[0], ("number", Whole, |track| track.number.map(|number| number.to_string()))];
const DESCRIBED_LAST: [TrackColumn; 5] = [
    ("lost_samples", Whole, LAST[0].2),
    ("redundancy_arcsec", Real, |track| track.residual.map(|(_, arcsec)| angle(arcsec))),
    ("redundancy_head", Text, |track| track.residual.map(|(head, _)| head.to_owned())),
    ("heads", Text, |track| track.heads.map(|heads| heads.names().join(" "))),
    NOTES,
];
const NOTES: TrackColumn = ("notes", Text, |track| Some(notes(track)).filter(|notes| !notes.is_empty()));
/// Columns of every unit.
const TURNED: [TrackColumn; 11] = [
    ("increment_x_arcsec", Real, |track| track.increment_control_arcsec.map(|[x, _, _]| angle(x))),
    ("increment_y_arcsec", Real, |track| track.increment_control_arcsec.map(|[_, y, _]| angle(y))),
    ("increment_z_arcsec", Real, |track| track.increment_control_arcsec.map(|[_, _, z]| angle(z))),
    ("angle_x_arcsec", Real, |track| Some(angle(track.angle_control_arcsec[0]))),
    ("angle_y_arcsec", Real, |track| Some(angle(track.angle_control_arcsec[1]))),
    ("angle_z_arcsec", Real, |track| Some(angle(track.angle_control_arcsec[2]))),
    ("q_w", Real, |track| Some(format!("{:.12}", track.attitude.w))),
    ("q_x", Real, |track| Some(format!("{:.12}", track.attitude.i))),
    ("q_y", Real, |track| Some(format!("{:.12}", track.attitude.j))),
    ("q_z", Real, |track| Some(format!("{:.12}", track.attitude.k))),
    ("valid", Flag, |track| Some(u8::from(track.is_complete).to_string())),
];
/// Columns in order; the first is the time.
pub fn track_columns(is_described: bool) -> impl Iterator<Item = TrackColumn> {
    let (first, last): (_, &[TrackColumn]) =
        if is_described { (DESCRIBED_FIRST, &DESCRIBED_LAST) } else { (FIRST, &LAST) };
    first.into_iter().chain(TURNED).chain(last.iter().copied())
}

/// The header of CSV.
pub fn track_header(is_described: bool) -> String {
    track_columns(is_described).map(|(name, ..)| name).collect::<Vec<_>>().join(",") + "\n"
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
            let cells = track_columns(track.number.is_some()).map(|(.., cell)| cell(track).unwrap_or_default());
            out.extend_from_slice(cells.collect::<Vec<_>>().join(",").as_bytes());
        }
        TrackFormat::Jsonl => {
            for (index, (name, kind, cell)) in track_columns(track.number.is_some()).enumerate() {
                out.push(if index == 0 { b'{' } else { b',' });
                quote(name, out);
                out.push(b':');
                match cell(track) {
                    Some(text) if kind == Text => quote(&text, out),
                    Some(number) => out.extend_from_slice(number.as_bytes()),
                    None => out.extend_from_slice(b"null"),
                }
            }
            out.push(b'}');
        }
    }
    out.push(b'\n');
}

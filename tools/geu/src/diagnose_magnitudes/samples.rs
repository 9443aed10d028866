//! Rates of a described unit from its recordings, with the defects as findings.

use geu_checks::Finding;
use geu_model::device::{Device, Output};
use geu_protocol::layout::Quantity;
use geu_recording::{DecoderOptions, Defect, DeviceDecoder, DeviceSample, InputReader, Sink, Stop};

use crate::command_error::CommandError;
use crate::diagnose::MAX_DEFECTS;

/// Heads of a unit that a magnitude calibrates.
pub const HEADS: usize = 3;

/// The rates of all heads in one sample interval.
#[derive(Debug, Clone)]
pub struct Sample {
    pub end_ns: i64,
    pub length_s: f64,
    pub rates_arcsec_s: [f64; HEADS],
}

/// Samples of the recordings of a unit of three heads, and their defects.
pub struct Samples<'a> {
    device: &'a Device,
    /// Name, trial and samples of each recording or trial, in the order of time.
    pub groups: Vec<(String, String, Vec<Sample>)>,
    pub findings: Vec<Finding>,
    /// Defects that are not listed.
    further: u64,
    link: String,
}

impl Samples<'_> {
    pub fn new(device: &Device) -> Samples<'_> {
        Samples { device, groups: Vec::new(), findings: Vec::new(), further: 0, link: String::new() }
    }

    /// Reads a recording.
    ///
    /// # Errors
    /// It cannot be read, or contains no sample.
    pub fn read(&mut self, link: &str, options: DecoderOptions) -> Result<(), CommandError> {
        link.clone_into(&mut self.link);
        let (first, device) = (self.groups.len(), self.device);
        let mut reader = InputReader::with(DeviceDecoder::new(device, &options), options, Stop::default());
        reader.read(link, self).map_err(CommandError::input)?;
        reader.finish(self).1.map_err(CommandError::input)?;
        if self.groups.len() == first {
            return Err(CommandError::input(format!("{link}: expected samples of {}, got none", device.name)));
        }
        if self.further > 0 {
            let text = format!("{} more; `geu decode` lists all", std::mem::take(&mut self.further));
            self.findings.push(Finding { kind: "defects".to_owned(), place: link.to_owned(), text });
        }
        Ok(())
    }

    /// Leaves out the samples stamped wrong, so that times rise.
    pub fn order(&mut self) {
        for (name, _, samples) in &mut self.groups {
            let count = samples.len();
            *samples = rising(std::mem::take(samples));
            if samples.len() < count {
                let text = format!("{} with times that do not rise with the others: left out", count - samples.len());
                self.findings.push(Finding { kind: "rows-left-out".to_owned(), place: name.clone(), text });
            }
        }
    }
}

impl Sink<DeviceSample> for Samples<'_> {
    fn row(&mut self, row: &DeviceSample) {
        let device = self.device;
        let interval_ns = device.interval_s * 1e9;
        let end_ns = row.time.map_or((row.number as f64 * interval_ns) as i64, |time| time.t_ns);
        let length_s = row.start.map_or(device.interval_s, |start| end_ns.saturating_sub(start.t_ns) as f64 * 1e-9);
        let mut rates_arcsec_s = [f64::NAN; HEADS];
        for (value, spec) in row.values.iter().zip(device.values()) {
            let per_s = if device.output == Output::Rate { 1.0 } else { length_s };
            match spec.quantity {
                Quantity::Output(head) => rates_arcsec_s[head] = value * spec.factor / per_s,
                Quantity::Valid(_) if *value == 0.0 => return,
                Quantity::Saturated(_) if *value == 1.0 => return,
                _ => {}
            }
        }
        // The magnitude needs all heads, and none of them clipped.
        let limit = device.range_arcsec_s * (1.0 - 1e-6);
        if !rates_arcsec_s.iter().all(|rate| rate.abs() < limit) {
            return;
        }
        let name = if row.group.is_empty() { self.link.clone() } else { format!("{}, {}", self.link, row.group) };
        if self.groups.last().is_none_or(|(last, ..)| *last != name) {
            self.groups.push((name, row.group.clone(), Vec::new()));
        }
        if let Some((_, _, samples)) = self.groups.last_mut() {
            samples.push(Sample { end_ns, length_s, rates_arcsec_s });
        }
    }

    fn defect(&mut self, defect: &Defect) {
        if self.findings.len() >= MAX_DEFECTS {
            self.further += 1;
            return;
        }
        let time = defect.time.map(|time| format!("at {} s", time.t_ns as f64 * 1e-9));
        let lost = (defect.lost > 0).then(|| format!("samples missing before it: {}", defect.lost));
        let bytes = (!defect.bytes.is_empty()).then(|| format!("{:?}", String::from_utf8_lossy(defect.bytes)));
        let text = time.into_iter().chain(lost).chain(bytes).collect::<Vec<_>>().join(", ");
        let kind = defect.kind.name().to_owned();
        self.findings.push(Finding { kind, place: defect.place_text(), text });
    }
}

/// The longest series of samples with rising times: those stamped wrong or again are left out.
fn rising(samples: Vec<Sample>) -> Vec<Sample> {
    // The last sample of the best series of each length, and the sample before each in its series.
    let (mut last, mut before): (Vec<usize>, Vec<Option<usize>>) = (Vec::new(), Vec::new());
    for (index, sample) in samples.iter().enumerate() {
        let length = last.partition_point(|&own| samples[own].end_ns < sample.end_ns);
        before.push(length.checked_sub(1).map(|length| last[length]));
        match last.get_mut(length) {
            Some(own) if samples[*own].end_ns > sample.end_ns => *own = index,
            Some(_) => {}
            None => last.push(index),
        }
    }
    let mut is_kept = vec![false; samples.len()];
    let mut at = last.last().copied();
    while let Some(index) = at {
        is_kept[index] = true;
        at = before[index];
    }
    samples.into_iter().zip(is_kept).filter_map(|(sample, is_kept)| is_kept.then_some(sample)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_stamped_wrong_are_left_out() {
        for (stamps, expected) in [
            (&[1, 2, 3][..], &[1, 2, 3][..]),
            (&[1, 2, 2, 3], &[1, 2, 3]),
            (&[1, 2, 103, 104, 5, 6, 7, 8], &[1, 2, 5, 6, 7, 8]),
            (&[101, 102, 3, 104, 105], &[101, 102, 104, 105]),
            (&[], &[]),
        ] {
            let sample = |end_ns: &i64| Sample { end_ns: *end_ns, length_s: 1.0, rates_arcsec_s: [0.0; HEADS] };
            let kept: Vec<i64> = rising(stamps.iter().map(sample).collect()).iter().map(|own| own.end_ns).collect();
            assert_eq!(kept, expected);
        }
    }
}

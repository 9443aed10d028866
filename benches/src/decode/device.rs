//! Inputs of described units: a candump log of a unit on CAN, and serial bytes.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::time::Instant;

use geu_model::device::Device;
use geu_protocol::capture::Format;
use geu_protocol::layout::{FrameSet, Quantity};
use geu_recording::{DecoderOptions, Defect, DeviceDecoder, DeviceSample, InputReader, Sink, Stop};

/// Units, each with its target: M lines/s on CAN, MB/s on a serial line.
const UNITS: [(&str, f64); 5] =
    [("mm5.10", 5.0), ("stim300", 300.0), ("kvh-1750", 300.0), ("mti-100", 300.0), ("tetrad", 300.0)];

/// An input of one unit.
pub struct UnitInput {
    pub name: &'static str,
    device: Device,
    path: PathBuf,
    /// Work in the file, its unit per second, and the target.
    pub work: (f64, &'static str, f64),
}

/// Writes the inputs: as many lines on CAN, or samples on a serial line.
///
/// # Errors
/// A file cannot be written.
pub fn inputs(directory: &Path, lines: u64) -> io::Result<Vec<UnitInput>> {
    let input = |(name, target): (&'static str, f64)| {
        let device = Device::from_name(name).expect("a known unit");
        let path = directory.join(name);
        let mut file = BufWriter::new(File::create(&path)?);
        let work = match (&device.can, &device.serial) {
            (Some(can), _) => {
                // Whole samples.
                let lines = lines - lines % can.frames.frames.len() as u64;
                write_can(&mut file, &can.frames, lines)?;
                (lines as f64 / 1e6, "M lines/s", target)
            }
            (None, Some(serial)) => {
                let length: usize = serial.frames.frames.iter().map(|frame| frame.length()).sum();
                write_serial(&mut file, &serial.frames, lines)?;
                ((lines * length as u64) as f64 / super::MEGABYTE, "MB/s", target)
            }
            (None, None) => unreachable!("these units have links"),
        };
        file.flush()?;
        Ok(UnitInput { name, device, path, work })
    };
    UNITS.into_iter().map(input).collect()
}

/// Values of a sample: sequence, validity, and numbers that change.
fn values(set: &FrameSet, index: u64) -> Vec<f64> {
    let value = |(slot, quantity): (usize, &Quantity)| match quantity {
        Quantity::Sequence => (index % set.sequence.0) as f64,
        Quantity::Valid(_) => 1.0,
        Quantity::Saturated(_) | Quantity::Status(_) => 0.0,
        _ => ((index * 7 + slot as u64 * 13) % 101) as f64 * 1e-3,
    };
    set.values.iter().map(|value| &value.quantity).enumerate().map(value).collect()
}

fn write_can(file: &mut impl Write, set: &FrameSet, lines: u64) -> io::Result<()> {
    let mut bytes = Vec::new();
    for line in 0..lines {
        let (index, frame) = (line / set.frames.len() as u64, &set.frames[line as usize % set.frames.len()]);
        bytes.clear();
        frame.write(&values(set, index), &mut bytes);
        let (id, _) = frame.id.expect("a message");
        let t_us = 1_795_020_000_500_000 + index * 10_000;
        write!(file, "({}.{:06}) can0 {id:03X}#", t_us / 1_000_000, t_us % 1_000_000)?;
        bytes.iter().try_for_each(|byte| write!(file, "{byte:02X}"))?;
        file.write_all(b"\n")?;
    }
    Ok(())
}

fn write_serial(file: &mut impl Write, set: &FrameSet, samples: u64) -> io::Result<()> {
    let mut bytes = Vec::new();
    for index in 0..samples {
        bytes.clear();
        let values = values(set, index);
        set.frames.iter().for_each(|frame| frame.write(&values, &mut bytes));
        file.write_all(&bytes)?;
    }
    Ok(())
}

/// Counts samples.
struct Counter(u64);

impl Sink<DeviceSample> for Counter {
    #[inline]
    fn row(&mut self, _row: &DeviceSample) {
        self.0 += 1;
    }

    fn defect(&mut self, defect: &Defect) {
        panic!("expected a recording without defects, got {}", defect.kind.name());
    }
}

impl UnitInput {
    /// Time to decode in this process, s.
    pub fn decode(&self) -> Result<f64, String> {
        let mut options = DecoderOptions::default();
        if self.device.can.is_none() {
            options.format = Format::from_name("serial");
        }
        let start = Instant::now();
        let (decoder, mut counter) = (DeviceDecoder::new(&self.device, &options), Counter(0));
        let mut reader = InputReader::with(decoder, options, Stop::default());
        let result = reader.read(&self.path.to_string_lossy(), &mut counter);
        let (_, ending) = reader.finish(&mut counter);
        let time_s = start.elapsed().as_secs_f64();
        result.and(ending).map_err(|error| error.to_string())?;
        Ok(time_s)
    }
}

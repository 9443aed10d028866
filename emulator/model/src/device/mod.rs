//! The description of a unit: heads, output, interval, and what it says on a serial line, on CAN and in tables.
//!
//! The units of `configs/devices` are known by their names. Every error of a description points at its place.
//!
//! ```
//! use geu_model::device::Device;
//! let device = Device::from_name("stim300").unwrap();
//! assert_eq!(device.gyros().map(|gyro| gyro.name()).collect::<Vec<_>>(), ["X", "Y", "Z"]);
//! ```

mod can;
pub mod columns;
mod fields;
mod model;
mod output;
mod serial;
mod table;

use std::cell::RefCell;
use std::sync::{Arc, LazyLock};

use geu_protocol::Gyro;
use geu_protocol::describe::Wire;
use geu_protocol::layout::{Coding, FrameSet, Quantity, ValueSpec};
use geu_protocol::suggestion::did_you_mean;

use crate::configuration::{ConfigText, ConfigurationError, Node};
use crate::package::{Axes, cross, dot};
use crate::parameter_spec::ValueFormat;
use crate::units::{ARCSEC_PER_DEG, FULL_SCALE_ARCSEC_S, SAMPLE_INTERVAL_S};

use self::fields::is_identifier;
pub use can::CanWire;
pub use serial::SerialWire;
pub use table::{ReferenceTable, TableWire, UnitColumn};

/// Largest number of heads.
pub const MAX_HEADS: usize = 8;
/// Rate of the clock of the default unit, and of a unit without a stated one.
const CLOCK_HZ: f64 = 1e6;
/// Deviation of a product of unit vectors from 0 up to which they are perpendicular.
const PERPENDICULAR: f64 = 1e-6;

/// Meaning of a head's output.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Output {
    /// Angle since the sample before.
    Increment,
    /// Mean rate over the sample interval.
    Rate,
}

/// One gyro of a unit.
#[derive(Debug, Clone, PartialEq)]
pub struct Head {
    pub gyro: Gyro,
    pub axes: Axes,
    /// Largest rate.
    pub full_scale_arcsec_s: f64,
    /// Nominal size of one count, arcsec.
    pub count_arcsec: f64,
    /// True if the output is a whole number of counts.
    pub is_rounded: bool,
}

impl Head {
    /// Two directions perpendicular to the input axis and to each other: control axes, if it is along a control axis.
    pub fn across(&self) -> [[f64; 3]; 2] {
        let input = self.axes.input_control;
        let unit = |axis: usize| std::array::from_fn(|other| f64::from(u8::from(other == axis)));
        if let Some(own) = input.iter().position(|part| part.abs() == 1.0) {
            return [unit(usize::from(own == 0)), unit(if own == 2 { 1 } else { 2 })];
        }
        let farthest = (0..3).min_by(|&one, &other| input[one].abs().total_cmp(&input[other].abs())).unwrap_or(0);
        let part = input[farthest];
        let across: [f64; 3] = std::array::from_fn(|axis| unit(farthest)[axis] - part * input[axis]);
        let length = across.iter().map(|part| part * part).sum::<f64>().sqrt();
        let across = across.map(|part| part / length);
        [across, cross(input, across)]
    }

    /// This number of counts as the output has it.
    #[inline]
    pub fn rounded(&self, counts: f64) -> f64 {
        if self.is_rounded { counts.round() } else { counts }
    }
}

/// The text of a description, and of the files that it names.
#[derive(Debug, Clone, Default)]
pub struct DeviceText {
    /// Name of the unit, or of the file; descriptions with the same text are the same.
    pub name: String,
    pub text: String,
    pub files: Vec<(String, String)>,
}

/// A unit as its description has it.
#[derive(Debug, Clone)]
pub struct Device {
    pub description: DeviceText,
    pub name: String,
    /// Documents of the numbers.
    pub source: String,
    /// Nominal interval of samples, on-board time, s.
    pub interval_s: f64,
    pub output: Output,
    /// Largest rate, arcsec/s; outputs beyond it are clipped.
    pub range_arcsec_s: f64,
    /// Rate of the unit's clock.
    pub clock_hz: f64,
    pub heads: Vec<Head>,
    /// Samples from one frame with an angle to the next; `None` without such frames.
    pub angle_samples: Option<u64>,
    /// The link of the default unit is not described: it has a codec of its own.
    pub serial: Option<SerialWire>,
    pub can: Option<CanWire>,
    pub table: Option<TableWire>,
}

impl PartialEq for Device {
    fn eq(&self, other: &Device) -> bool {
        let (own, other) = (&self.description, &other.description);
        (&own.text, &own.files) == (&other.text, &other.files)
    }
}

/// Name of the default unit, which has no description.
pub const DEFAULT_DEVICE: &str = "iras";

/// Declares the units of `configs/devices`: name, description, and the files that the description names.
macro_rules! devices {
    ($($name:literal [$($file:literal)*];)*) => {
        /// Names and descriptions of the units that are known by name.
        pub const DEVICES: &[(&str, &str)] =
            &[$(($name, include_str!(concat!("../../../../configs/devices/", $name, ".toml")))),*];
        /// Files that these descriptions name.
        const FILES: &[(&str, &str)] =
            &[$($(($file, include_str!(concat!("../../../../configs/devices/", $file))),)*)*];
    };
}

devices! {
    "hg4930" [];
    "kvh-1750" [];
    "mm5.10" ["mm5.10.dbc"];
    "mti-100" [];
    "openimu300ri" ["openimu300ri.dbc"];
    "stim300" [];
    "stim300-increment" [];
    "suchai3" [];
    "tetrad" [];
}

/// Reads a file that a description names; the error is in words.
pub type Files<'a> = &'a dyn Fn(&str) -> Result<String, String>;

impl Device {
    /// The unit of that name; `None` if there is none.
    ///
    /// # Panics
    /// For a description of this crate that is not valid; a test reads each.
    pub fn from_name(name: &str) -> Option<Device> {
        let (name, text) = DEVICES.iter().find(|(own, _)| *own == name)?;
        let files = |file: &str| {
            let known = FILES.iter().find(|(own, _)| *own == file);
            known.map(|(_, text)| (*text).to_owned()).ok_or_else(|| "no such file".to_owned())
        };
        let device = Device::parse(&format!("{name}.toml"), text, &files);
        Some(device.unwrap_or_else(|error| panic!("{error}")))
    }

    /// Name of a known unit with this description.
    pub fn known_name(&self) -> Option<&'static str> {
        let DeviceText { text, files, .. } = &self.description;
        let is_known = |(file, text): &(String, String)| FILES.contains(&(file.as_str(), text.as_str()));
        DEVICES.iter().find(|(_, known)| known == text).filter(|_| files.iter().all(is_known)).map(|(name, _)| *name)
    }

    /// The default unit, four floated gyros with outputs of 16 bits (Casteren §2, §5).
    pub fn iras() -> Arc<Device> {
        static IRAS: LazyLock<Arc<Device>> = LazyLock::new(|| {
            let head = |gyro| Head {
                gyro,
                axes: *Axes::of(gyro),
                full_scale_arcsec_s: FULL_SCALE_ARCSEC_S,
                count_arcsec: 1.0,
                is_rounded: true,
            };
            Arc::new(Device {
                description: DeviceText::default(),
                name: "IRAS gyro unit".to_owned(),
                source: "Casteren".to_owned(),
                interval_s: SAMPLE_INTERVAL_S,
                output: Output::Increment,
                range_arcsec_s: FULL_SCALE_ARCSEC_S,
                clock_hz: CLOCK_HZ,
                heads: Gyro::ALL.map(head).to_vec(),
                angle_samples: None,
                serial: None,
                can: None,
                table: None,
            })
        });
        IRAS.clone()
    }

    /// Reads a description; errors call it `name`. `files` reads the files that it names.
    ///
    /// # Errors
    /// The description is not valid, with its place.
    pub fn parse(name: &str, text: &str, files: Files) -> Result<Device, ConfigurationError> {
        let document = ConfigText::parse(name, text)?;
        let root = document.root();
        root.only(&["device"])?;
        let node = root.table("device")?;
        let node = node.ok_or_else(|| root.error("device", "expected a table [device], got none".to_owned()))?;
        let numbers = ["interval_s", "output", "range_arcsec_s", "clock_hz"];
        node.only(&[&["name", "source", "head", "serial", "can", "table"][..], &numbers].concat())?;
        let heads = node.tables("head")?;
        let heads = heads.iter().zip(0..=u8::MAX);
        let heads = heads.map(|(node, index)| head(node, index)).collect::<Result<Vec<_>, _>>()?;
        if heads.is_empty() || heads.len() > MAX_HEADS {
            let message = format!("expected 1 to {MAX_HEADS} tables [[device.head]], got {}", heads.len());
            return Err(node.error("head", message));
        }
        for (index, head) in heads.iter().enumerate() {
            if heads[..index].iter().any(|other| other.gyro.name() == head.gyro.name()) {
                return Err(
                    node.error("head", format!("expected heads of different names, got {} twice", head.gyro.name()))
                );
            }
        }
        let is_rate = node.choice("output", &["increment", "rate"])? == "rate";
        let read = RefCell::new(Vec::new());
        let files = |name: &str| {
            let text = files(name)?;
            read.borrow_mut().push((name.to_owned(), text.clone()));
            Ok(text)
        };
        let mut device = Device {
            description: DeviceText { name: name.to_owned(), text: text.to_owned(), files: Vec::new() },
            name: node.text("name")?.to_owned(),
            source: node.text("source")?.to_owned(),
            interval_s: positive(&node, "interval_s", 1e-5, 1e4)?,
            output: if is_rate { Output::Rate } else { Output::Increment },
            range_arcsec_s: positive(&node, "range_arcsec_s", 1e-3, 1e9)?,
            clock_hz: match node.keys().contains(&"clock_hz") {
                true => positive(&node, "clock_hz", 1e-3, 1e9)?,
                false => CLOCK_HZ,
            },
            heads,
            angle_samples: None,
            serial: None,
            can: None,
            table: None,
        };
        device.serial = node.table("serial")?.map(|serial| SerialWire::read(&serial, &device)).transpose()?;
        let values = device.values().to_vec();
        device.can = node.table("can")?.map(|can| CanWire::read(&can, &device, values, &files)).transpose()?;
        let values = device.values().to_vec();
        device.table = node.table("table")?.map(|table| TableWire::read(&table, &device, values)).transpose()?;
        let values = device.values().to_vec();
        for set in device.sets_mut() {
            Arc::make_mut(set).values.clone_from(&values);
        }
        if let (Some(serial), Some(can)) = (&device.serial, &device.can) {
            let is_shared = |name: &str| serial.frames.frames.iter().any(|frame| frame.name.eq_ignore_ascii_case(name));
            if let Some(frame) = can.frames.frames.iter().find(|frame| is_shared(&frame.name)) {
                let message = format!("expected messages of other names than the serial frames, got {}", frame.name);
                return Err(node.error("can", message));
            }
        }
        if device.sets().next().is_none() {
            let message = "expected a table [device.serial], [device.can] or [device.table], got none";
            return Err(node.error("serial", message.to_owned()));
        }
        device.angle_samples = device.samples_of_angles().map_err(|message| node.error("serial", message))?;
        device.count_sizes();
        device.description.files = read.into_inner();
        Ok(device)
    }

    /// Frames of the serial line, of CAN and of the table, where the unit has them.
    fn sets(&self) -> impl Iterator<Item = &Arc<FrameSet>> {
        let serial = self.serial.iter().map(|serial| &serial.frames);
        serial.chain(self.can.iter().map(|can| &can.frames)).chain(self.table.iter().map(|table| &table.frames))
    }

    fn sets_mut(&mut self) -> impl Iterator<Item = &mut Arc<FrameSet>> {
        let serial = self.serial.iter_mut().map(|serial| &mut serial.frames);
        let can = self.can.iter_mut().map(|can| &mut can.frames);
        serial.chain(can).chain(self.table.iter_mut().map(|table| &mut table.frames))
    }

    /// One count is one unit of the number on the wire, on the serial line if there are two; of a float it is an arcsec.
    fn count_sizes(&mut self) {
        let mut sizes = Vec::new();
        for head in 0..self.heads.len() {
            let mut fields = self.sets().flat_map(|set| {
                let slot = set.slot(&Quantity::Output(head));
                let fields = set.frames.iter().flat_map(|frame| &frame.fields);
                fields.filter(move |field| Some(field.slot) == slot).map(|field| (field, &set.values[field.slot]))
            });
            let whole = fields.next().filter(|(field, _)| field.place.coding != Coding::Float);
            sizes.push(whole.map(|(field, value)| field.scale().abs() * self.arcsec_per_unit(value)));
        }
        for (head, size) in self.heads.iter_mut().zip(sizes) {
            (head.count_arcsec, head.is_rounded) = (size.unwrap_or(1.0), size.is_some());
            head.full_scale_arcsec_s = self.range_arcsec_s;
        }
    }

    /// Output, rate of samples and range.
    pub fn in_words(&self) -> String {
        let output = match self.output {
            Output::Increment => "increments",
            Output::Rate => "rates",
        };
        format!("{output}, {}, up to {} deg/s", self.rate_in_words(), self.range_arcsec_s / ARCSEC_PER_DEG)
    }

    /// Rate of samples.
    pub fn rate_in_words(&self) -> String {
        format!("{} Hz", (1e6 / self.interval_s).round() / 1e6)
    }

    /// The links, for descriptions; `prefix` begins identifiers of programs.
    pub fn wire<'a>(&'a self, prefix: &'a str) -> Wire<'a> {
        let serial = self.serial.as_ref().map(|serial| ("serial line", serial.baud, &*serial.frames));
        let can = self.can.as_ref().map(|can| ("CAN", can.bitrate, &*can.frames));
        Wire {
            prefix,
            title: &self.name,
            source: &self.source,
            heads: self.heads.iter().map(|head| (head.gyro.name(), head.axes.input_control)).collect(),
            output: self.in_words(),
            range: self.range_arcsec_s * if matches!(self.output, Output::Rate) { 1.0 } else { self.interval_s },
            links: serial.into_iter().chain(can).collect(),
        }
    }

    /// Values of a sample, the same on all links.
    pub fn values(&self) -> &[ValueSpec] {
        self.sets().last().map_or(&[], |frames| &frames.values)
    }

    /// True if frames are found without a constant or a check of all fields.
    pub fn is_unchecked(&self) -> bool {
        self.serial.as_ref().is_some_and(|serial| serial.is_unchecked)
    }

    /// The head of that name.
    ///
    /// # Errors
    /// There is none: the message.
    fn head(&self, name: &str) -> Result<usize, String> {
        self.gyro(name).map(Gyro::index).ok_or_else(|| {
            let names: Vec<&str> = self.gyros().map(Gyro::name).collect();
            format!("{}expected a head ({}), got {name}", did_you_mean(name, &names), names.join(", "))
        })
    }
}

fn positive(node: &Node, key: &str, min: f64, max: f64) -> Result<f64, ConfigurationError> {
    let expected = format!("a number from {min} to {max}");
    node.value(key, ValueFormat::Real, min, max)?.ok_or_else(|| node.unexpected(key, &expected))
}

fn head(node: &Node, index: u8) -> Result<Head, ConfigurationError> {
    node.only(&["name", "input", "output"])?;
    let axis = |key: &str| -> Result<[f64; 3], ConfigurationError> {
        let expected = "a direction, three numbers that are not all 0,";
        let axis = <[f64; 3]>::try_from(node.reals(key)?).map_err(|_| node.unexpected(key, expected))?;
        let length = axis.iter().map(|part| part * part).sum::<f64>().sqrt();
        match length.is_normal() {
            true => Ok(axis.map(|part| part / length)),
            false => Err(node.unexpected(key, expected)),
        }
    };
    let input = axis("input")?;
    let output = node.keys().contains(&"output").then(|| axis("output")).transpose()?;
    if output.is_some_and(|output| dot(input, output).abs() > PERPENDICULAR) {
        return Err(node.unexpected("output", "an axis perpendicular to the input axis"));
    }
    let name = node.text("name")?;
    match is_identifier(name) {
        true => Ok(Head {
            gyro: Gyro::new(index, name),
            axes: Axes::new(input, output.unwrap_or_default()),
            full_scale_arcsec_s: 0.0,
            count_arcsec: 1.0,
            is_rounded: false,
        }),
        false => Err(node.unexpected("name", "a name of letters, digits and underscores")),
    }
}

#[cfg(test)]
mod tests;

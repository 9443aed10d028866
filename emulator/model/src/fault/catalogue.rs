//! Named faults: of a gyro, of the unit, and of links ([`link_fault`]). The recorder applies those of links to bytes; the catalogue
//! holds their parameters, the transports that support them, and the alternatives where none does.

pub mod link_fault;

use std::sync::LazyLock;

use geu_protocol::{Gyro, named};

use crate::fault::ParameterRef;
use crate::parameter_spec::{ParameterSet, ParameterSpec, numbers};
use crate::time_profile::{self, TimeProfile};
pub use link_fault::LinkFault;

named! {
    /// A kind of link.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
    pub enum Transport {
        /// A pty.
        Pty = "pty",
        /// A serial port.
        Serial = "serial",
        /// A CAN interface.
        Can = "can",
        /// TCP.
        Tcp = "tcp",
    }
}

named! {
    /// The target of a fault.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum Scope {
        /// One gyro.
        Gyro = "gyro",
        /// The whole unit.
        Unit = "unit",
        /// Links.
        Link = "link",
    }
}

/// Action of a fault on a gyro's counts, after rounding and wiring, before clipping.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(missing_docs)]
pub enum GyroFault {
    Dead,
    StuckCount { counts: f64 },
    WrongLsb { factor: f64 },
    Spike { counts: f64, law: SpikeLaw },
    Garbage,
    Saturated { is_negative: bool },
    SpinDown { coast_s: f64 },
}

named! {
    /// Distribution of the size of a spike.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    #[allow(missing_docs)]
    pub enum SpikeLaw {
        Constant = "constant",
        Alternating = "alternating",
        Uniform = "uniform",
        Normal = "normal",
    }
}

/// Action of a fault on the unit.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(missing_docs)]
pub enum UnitFault {
    Reset,
    BrownOut,
    BootDelay,
    FlipFlags { gyro_flags: u8, unit_flags: u8 },
    ClockJump { cycles: i64 },
    HeaterLost,
}

/// Action of a fault.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FaultAction {
    /// Moves a parameter of an effect, as a fault of that parameter would.
    Parameter {
        /// The parameter.
        target: ParameterRef,
        /// Size.
        size: f64,
        /// Course.
        course: TimeProfile,
    },
    /// On one gyro.
    Head(GyroFault),
    /// On the unit.
    Unit(UnitFault),
    /// On links.
    Link(LinkFault),
}

/// Specification of a named fault.
#[derive(Clone, Copy)]
pub struct FaultSpec {
    /// Name in a plan.
    pub code: &'static str,
    pub scope: Scope,
    pub meaning: &'static str,
    pub numbers: &'static [ParameterSpec],
    /// Duration if a plan gives none; `None` for no end.
    pub for_s: Option<f64>,
    /// For a fault of a link: where it cannot be done, why, and what could.
    pub unable: &'static [(Transport, &'static str)],
    /// For a fault of a link: what some links hold its numbers to.
    pub bounds: &'static [Bound],
    /// Number and value with which the fault would change nothing.
    pub neutral: Option<(&'static str, f64)>,
    law: fn(&[f64]) -> FaultAction,
}

/// Limit of a number on some transports.
#[derive(Debug)]
pub struct Bound {
    /// The number's name.
    pub number: &'static str,
    /// The links.
    pub links: &'static [Transport],
    /// The largest value there.
    pub most: f64,
    /// Quantity that the number counts there.
    what: &'static str,
}

impl PartialEq for FaultSpec {
    fn eq(&self, other: &FaultSpec) -> bool {
        self.code == other.code
    }
}

impl std::fmt::Debug for FaultSpec {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.code)
    }
}

impl FaultSpec {
    const fn new(
        scope: Scope,
        code: &'static str,
        meaning: &'static str,
        numbers: &'static [ParameterSpec],
        law: fn(&[f64]) -> FaultAction,
    ) -> FaultSpec {
        FaultSpec { code, scope, meaning, numbers, for_s: None, unable: &[], bounds: &[], neutral: None, law }
    }

    /// The fault of that name.
    pub fn from_name(code: &str) -> Option<&'static FaultSpec> {
        CATALOGUE.iter().find(|spec| spec.code == code)
    }

    /// The action with these values of [`FaultSpec::numbers`].
    pub fn law(&self, numbers: &[f64]) -> FaultAction {
        (self.law)(numbers)
    }

    /// Reason that a transport cannot have it; `None` if it can.
    pub fn unable_on(&self, link: Transport) -> Option<&'static str> {
        self.unable.iter().find(|(kind, _)| *kind == link).map(|(_, reason)| *reason)
    }

    /// A number with which it would change nothing, and what was expected of it.
    pub fn neutral(&self, numbers: &[f64], gyro: Option<Gyro>) -> Option<(&'static str, String)> {
        let other = |number, value: &str| Some((number, format!("another than {value}, with which nothing changes,")));
        if let Some((name, value)) = self.neutral
            && self.numbers.iter().zip(numbers).any(|(number, &given)| number.name == name && given == value)
        {
            return other(name, &value.to_string());
        }
        match self.law(numbers) {
            FaultAction::Unit(UnitFault::FlipFlags { gyro_flags: 0, unit_flags: 0 }) => {
                Some(("gyro_flags", "a mask with at least one bit, here or in `unit_flags`,".to_owned()))
            }
            FaultAction::Parameter { size, .. }
                if gyro.is_some_and(|gyro| size == gyro.index() as f64 + 1.0) && self.code == "axis-swap" =>
            {
                other("with", "its own gyro")
            }
            _ => None,
        }
    }

    /// A number that cannot be on any of these links, which the fault is on, and what was expected of it.
    pub fn misfit(&self, numbers: &[f64], links: &[Transport]) -> Option<(&'static str, String)> {
        let is_beyond = |bound: &Bound| {
            let mut values = self.numbers.iter().zip(numbers);
            values.any(|(number, &value)| number.name == bound.number && value > bound.most)
                && bound.links.iter().any(|link| links.contains(link))
        };
        let Bound { number, most, what, .. } = self.bounds.iter().find(|bound| is_beyond(bound))?;
        Some((number, format!("at most {most} {what}, or another `link`,")))
    }

    /// Links that can have it.
    pub fn links(&self) -> Vec<Transport> {
        Transport::ALL.into_iter().filter(|&kind| self.unable_on(kind).is_none()).collect()
    }
}

/// The numbers of a fault, with these values.
fn from_values<N: ParameterSet + Default>(values: &[f64]) -> N {
    let mut numbers = N::default();
    values.iter().enumerate().for_each(|(index, value)| *numbers.value_mut(index) = *value);
    numbers
}

fn moved(parameter: &str, size: f64, profile: &str, shapes: &[f64]) -> FaultAction {
    let course = time_profile::from_name(profile).with(shapes);
    FaultAction::Parameter { target: ParameterRef::from_name(parameter).expect("a number of an effect"), size, course }
}

/// Every named fault.
pub static CATALOGUE: LazyLock<Vec<FaultSpec>> =
    LazyLock::new(|| [GYRO_AND_UNIT, link_fault::POSSIBLE, link_fault::IMPOSSIBLE].concat());

/// Specifications of faults: meaning, code, scope and other fields of [`FaultSpec`] that are not the default, numbers, and the
/// action by them.
macro_rules! fault_specs {
    ($($(#[doc = $meaning:literal])* $code:literal ($scope:ident $(, $key:ident: $value:expr)*) {
        $($(#[doc = $text:literal])* $number:ident: $default:tt, $min:literal ..= $max:expr, $unit:literal $(, $form:ident $(($names:expr))?)?;)*
    } => $action:expr;)*) => {
        &[$({
            numbers! {
                /// The numbers of the fault.
                struct Numbers {
                    $($(#[doc = $text])* $number: $default, $min ..= $max, $unit $(, $form $(($names))?)?;)*
                }
            }
            FaultSpec {
                $($key: $value,)*
                ..FaultSpec::new(Scope::$scope, $code, concat!($($meaning),*).trim_ascii(), Numbers::NUMBERS, |values| {
                    let Numbers { $($number),* } = from_values(values);
                    $action
                })
            }
        }),*]
    };
}

const GYRO_AND_UNIT: &[FaultSpec] = fault_specs! {
    /// reads 0, not valid
    "dead" (Gyro) {} => FaultAction::Head(GyroFault::Dead);
    /// every increment is the same, flagged as if it were right
    "stuck-count" (Gyro) {
        /// the increment
        counts: required, -32768.0..=32767.0, "counts", Whole;
    } => FaultAction::Head(GyroFault::StuckCount { counts });
    /// the last increment is repeated
    "stuck-rate" (Gyro) {} => moved("stuck-output.on", 1.0, "step", &[]);
    /// counts have the other sign
    "sign-flip" (Gyro) {} => moved("sign-inversion.on", 1.0, "step", &[]);
    /// counts of two gyros stand in each other's place
    "axis-swap" (Gyro) {
        /// the other gyro
        with: required, 1.0..=8.0, "", Gyro;
    } => moved("axis-swap.with", with, "step", &[]);
    /// counts are of another size
    "wrong-lsb" (Gyro, neutral: Some(("factor", 1.0))) {
        /// counts told for one that is meant
        factor: required, -256.0..=256.0, "";
    } => FaultAction::Head(GyroFault::WrongLsb { factor });
    /// counts are added in each sample interval
    "spike" (Gyro, for_s: Some(0.5), neutral: Some(("counts", 0.0))) {
        /// size: the value, the largest, or the deviation
        counts: required, -65535.0..=65535.0, "counts";
        /// how the size is drawn
        law: 0.0, 0.0..=3.0, "", Choice(&SpikeLaw::NAMES);
    } => FaultAction::Head(GyroFault::Spike { counts, law: SpikeLaw::ALL[law as usize] });
    /// any 16 bits, flagged as if they were right
    "garbage" (Gyro) {} => FaultAction::Head(GyroFault::Garbage);
    /// the largest increment, flagged saturated
    "saturated" (Gyro) {
        /// whether it is the most negative one
        negative: 0.0, 0.0..=1.0, "", Flag;
    } => FaultAction::Head(GyroFault::Saturated { is_negative: negative != 0.0 });
    /// the angle random walk grows and stays
    "noise-growth" (Gyro) {
        /// what the walk grows by
        arcsec_per_sqrt_s: required, 1e-6..=100.0, "arcsec/√s";
        /// how long it grows
        over_s: required, 0.5..=1e9, "s";
    } => moved("angle-random-walk.arcsec_per_sqrt_s", arcsec_per_sqrt_s, "ramp", &[over_s]);
    /// the spin motor coasts: counts fade, not valid, not synchronous; 60 s of spin-up when it is over
    "spin-down" (Gyro) {
        /// time constant of the coast
        coast_s: 30.0, 0.5..=1e6, "s";
    } => FaultAction::Head(GyroFault::SpinDown { coast_s });
    /// the sensor's heater gives nothing, whatever is commanded
    "heater-lost" (Unit) {} => FaultAction::Unit(UnitFault::HeaterLost);
    /// the electronics restart: silent meanwhile, then sequence and clock from 0, cyclic, no self-test; gyros run on
    "reset" (Unit, for_s: Some(2.0)) {} => FaultAction::Unit(UnitFault::Reset);
    /// power is lost: silent meanwhile, then as after a reset, heater on, and the gyros spin up again
    "brown-out" (Unit, for_s: Some(2.0)) {} => FaultAction::Unit(UnitFault::BrownOut);
    /// silent until it is over, then sequence and clock from 0; on from the start, the unit boots late
    "boot-delay" (Unit, for_s: Some(2.0)) {} => FaultAction::Unit(UnitFault::BootDelay);
    /// flags contradict the data: these bits are told the wrong way
    "flip-flags" (Unit) {
        /// mask
        gyro_flags: 0.0, 0.0..=255.0, "", Whole;
        /// mask
        unit_flags: 0.0, 0.0..=255.0, "", Whole;
    } => FaultAction::Unit(UnitFault::FlipFlags { gyro_flags: gyro_flags as u8, unit_flags: unit_flags as u8 });
    /// the clock count jumps once and goes on from there
    "clock-jump" (Unit, for_s: Some(0.5), neutral: Some(("cycles", 0.0))) {
        /// cycles of the unit clock
        cycles: required, -1e12..=1e12, "cycles", Whole;
    } => FaultAction::Unit(UnitFault::ClockJump { cycles: cycles as i64 });
};

#[cfg(test)]
mod tests;

//! A set of gyros of one unit.
//!
//! ```
//! use geu_protocol::{Gyro, Gyros};
//! let both = Gyros::ALL.filter(|gyro| gyro >= Gyro::ZA.index());
//! assert!(both[3] && !both[0] && both.is_within(&Gyros::ALL));
//! assert_eq!(both.names(), ["GYRZA", "GYRZB"]);
//! ```

use std::cmp::Ordering;
use std::collections::BTreeSet;
use std::ops::Index;
use std::sync::{Mutex, PoisonError};

use crate::field::Gyro;

/// A set of gyros of one unit, by their numbers.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct Gyros {
    unit: &'static [Gyro],
    mask: u8,
}

impl Gyros {
    /// All gyros of the default unit.
    pub const ALL: Gyros = Gyros { unit: &Gyro::ALL, mask: 0x0F };

    /// All gyros of a unit, 1 to 8. Their list is kept for the rest of the process, each list once.
    pub fn of_unit(gyros: &[Gyro]) -> Gyros {
        static KEPT: Mutex<BTreeSet<&'static [Gyro]>> = Mutex::new(BTreeSet::new());
        let mut kept = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
        let known = kept.get(gyros).copied();
        let unit: &[Gyro] = known.unwrap_or_else(|| Box::leak(gyros.to_vec().into_boxed_slice()));
        kept.insert(unit);
        Gyros { unit, mask: u8::MAX >> (8 - unit.len().clamp(1, 8)) }
    }

    /// The gyros with these names, of this unit; `None` without a name, or with another name.
    pub fn from_names(self, names: &[&str]) -> Option<Gyros> {
        let is_gyro = |name: &&str| self.unit.iter().any(|gyro| gyro.name() == *name);
        let is_valid = !names.is_empty() && names.iter().all(is_gyro);
        is_valid.then(|| self.unit().filter(|gyro| names.contains(&self.unit[gyro].name())))
    }

    /// All gyros of the unit.
    #[must_use]
    pub fn unit(self) -> Gyros {
        Gyros { mask: u8::MAX >> (8 - self.unit.len().clamp(1, 8)), ..self }
    }

    /// Number of gyros of the unit.
    pub fn heads(&self) -> usize {
        self.unit.len()
    }

    /// Iterates over its gyros, in the order of the unit.
    pub fn gyros(self) -> impl Iterator<Item = Gyro> {
        self.unit.iter().copied().filter(move |gyro| self[gyro.index()])
    }

    /// Names of its gyros.
    pub fn names(&self) -> Vec<&'static str> {
        self.gyros().map(Gyro::name).collect()
    }

    /// Number of its gyros.
    pub fn count(&self) -> usize {
        self.mask.count_ones() as usize
    }

    pub fn is_empty(&self) -> bool {
        self.mask == 0
    }

    /// True for all gyros of the unit.
    pub fn is_all(&self) -> bool {
        *self == self.unit()
    }

    /// Bits of its gyros, the first the lowest.
    pub fn mask(&self) -> usize {
        usize::from(self.mask)
    }

    /// The gyros of the unit with these bits.
    #[must_use]
    pub fn with_mask(self, mask: usize) -> Gyros {
        Gyros { mask: mask as u8 & self.unit().mask, ..self }
    }

    /// One gyro of the unit.
    #[must_use]
    pub fn only(self, gyro: usize) -> Gyros {
        self.with_mask(1 << gyro)
    }

    /// Keeps the gyros for which `has` is true.
    #[must_use]
    pub fn filter(self, has: impl Fn(usize) -> bool) -> Gyros {
        let bit = |gyro: usize| usize::from(self[gyro] && has(gyro)) << gyro;
        self.with_mask((0..self.unit.len()).map(bit).sum())
    }

    /// The gyros of both.
    #[must_use]
    pub fn and(self, other: Gyros) -> Gyros {
        Gyros { mask: self.mask | other.mask, ..self }
    }

    /// Removes the gyros of the other set.
    #[must_use]
    pub fn without(self, other: Gyros) -> Gyros {
        Gyros { mask: self.mask & !other.mask, ..self }
    }

    /// True if all its gyros are among the others.
    pub fn is_within(&self, others: &Gyros) -> bool {
        self.mask & !others.mask == 0
    }

    /// True if the sets have a gyro in common.
    pub fn overlaps(&self, other: &Gyros) -> bool {
        self.mask & other.mask != 0
    }
}

impl Ord for Gyros {
    /// Compares by the first gyro of only one of the sets.
    fn cmp(&self, other: &Gyros) -> Ordering {
        (self.mask.reverse_bits(), self.unit).cmp(&(other.mask.reverse_bits(), other.unit))
    }
}

impl PartialOrd for Gyros {
    fn partial_cmp(&self, other: &Gyros) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Default for Gyros {
    /// An empty set of the default unit.
    fn default() -> Gyros {
        Gyros { mask: 0, ..Gyros::ALL }
    }
}

impl Index<usize> for Gyros {
    type Output = bool;

    /// True if the set has the gyro with this number.
    #[inline]
    fn index(&self, gyro: usize) -> &bool {
        if gyro < 8 && self.mask >> gyro & 1 != 0 { &true } else { &false }
    }
}

impl std::fmt::Debug for Gyros {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_list().entries(self.gyros()).finish()
    }
}

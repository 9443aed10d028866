//! Consistency of the catalogue.

use super::*;
use crate::parameter_spec::DefaultValue;

#[test]
fn codes_are_unique_and_numbers_within_their_limits() {
    for (index, spec) in CATALOGUE.iter().enumerate() {
        assert!(CATALOGUE[..index].iter().all(|other| other.code != spec.code), "{}", spec.code);
        assert!(spec.scope == Scope::Link || spec.unable.is_empty(), "{}", spec.code);
        for number in spec.numbers {
            assert!(number.min <= number.max, "{} {}", spec.code, number.name);
            if let DefaultValue::Value(value) = number.default {
                assert!((number.min..=number.max).contains(&value), "{} {}", spec.code, number.name);
            }
        }
    }
}

#[test]
fn what_no_link_can_do_says_what_could_on_each() {
    for spec in CATALOGUE.iter().filter(|spec| spec.scope == Scope::Link) {
        let is_impossible = ["parity-error", "framing-error", "bus-off", "bit-error"].contains(&spec.code);
        assert_eq!(spec.links().is_empty(), is_impossible, "{}", spec.code);
        assert!(spec.unable.iter().all(|(_, reason)| reason.len() > 20), "{}", spec.code);
    }
}

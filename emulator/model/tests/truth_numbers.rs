//! What a configuration says of a truth from a simulator.

use geu_model::Configuration;
use geu_model::attitude::TruthNumbers;
use geu_model::device::Device;

#[test]
fn numbers_of_a_truth_are_read_shown_described_and_limited() {
    let text = "[truth]\nmax_rate_deg_s = 30.0\nobliquity_deg = 0.0\n";
    let configuration = Configuration::parse("test.toml", text, &[]).expect("valid");
    let expected = TruthNumbers { max_rate_deg_s: 30.0, obliquity_deg: 0.0, ..TruthNumbers::default() };
    assert_eq!(configuration.truth, expected);
    for complete in [false, true] {
        let shown = configuration.to_toml(complete);
        assert!(shown.contains("[truth]\n") && shown.contains("max_rate_deg_s = 30.0"), "{shown}");
        assert_eq!(Configuration::parse("shown", &shown, &[]).expect("valid"), configuration);
    }
    let schema = &Configuration::schema(Device::iras())["properties"]["truth"]["properties"]["max_rate_deg_s"];
    assert_eq!((schema["default"].as_f64(), schema["maximum"].as_f64()), (Some(100.0), Some(3600.0)), "{schema}");
    let message = Configuration::parse("test.toml", "[truth]\nmax_rate_deg_s = 0\n", &[]).expect_err("too small");
    assert!(message.to_string().contains("truth.max_rate_deg_s"), "{message}");
}

#[test]
fn the_default_limit_of_rates_is_shown_and_beyond_the_range_of_a_gyro() {
    let reference = Configuration::reference();
    assert!(reference.to_toml(true).contains("max_rate_deg_s = 100.0"));
    // A recorded run without numbers of its own keeps its bytes.
    assert!(!reference.to_toml(false).contains("[truth]"));
    let range_deg_s = f64::from(i16::MAX) / 3600.0 / 0.5;
    assert!(reference.truth.max_rate_deg_s > 5.0 * range_deg_s);
}

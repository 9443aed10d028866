//! Described units of the independent model: `geu decode` reads the numbers that it sends.

use std::fs;

use geu_plant::{Case, DeviceEffect, DeviceMotionKind, DevicePlant, DeviceUnit, Mix, Wire};
use geu_tests::geu;

/// Decoded numbers of each sample, in counts.
fn decoded(plant: &DevicePlant, link: &[u8], count: f64) -> Vec<Vec<f64>> {
    let folder = tempfile::tempdir().expect("a folder");
    let name = if plant.unit.wire == Wire::Mm510 { "link.log" } else { "link.bin" };
    let path = folder.path().join(name);
    fs::write(&path, link).expect("written");
    let output = geu().args(["decode", "--device", plant.unit.name]).arg(&path).output().expect("geu starts");
    let summary = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{summary}");
    let text = String::from_utf8(output.stdout).expect("UTF-8");
    let header: Vec<&str> = text.lines().next().expect("a header").split(',').collect();
    let column = |head: &str| {
        let is_own =
            |name: &&str| name.starts_with(&format!("{head}_arcsec")) || name.starts_with(&format!("{head}_deg"));
        header.iter().position(is_own).unwrap_or_else(|| panic!("no {head} in {header:?}"))
    };
    let columns: Vec<usize> = plant.unit.heads.iter().map(|(name, _)| column(name)).collect();
    let row = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        columns.iter().map(|column| cells[*column].parse::<f64>().expect("a number") / count).collect()
    };
    text.lines().skip(1).map(row).collect()
}

#[test]
fn every_number_of_a_described_unit_is_decoded_as_it_was_sent() {
    for (unit, count) in DeviceUnit::all().into_iter().zip([1.0 / 16384.0, 0.01, 0.005]) {
        for motion in DeviceMotionKind::ALL {
            // The motion starts within 20 s.
            let Case { plant, .. } = Case::drawn(&unit, Mix::Effects, 1, 0, Some(motion), Some(22.0));
            let recording = plant.record(true);
            let rows = decoded(&plant, &recording.link, count);
            assert_eq!(rows.len(), recording.samples.len());
            for (row, (index, sent)) in rows.iter().zip(&recording.samples) {
                for (read, number) in row.iter().zip(sent) {
                    // Nine digits of a decimal number.
                    assert!(
                        (read - number).abs() < 1e-6 * (1.0 + number.abs()),
                        "{} {index}: {row:?} {sent:?}",
                        unit.name
                    );
                }
            }
        }
    }
}

#[test]
fn lost_samples_are_decoded_as_gaps() {
    for unit in DeviceUnit::all() {
        let Case { plant, .. } = Case::drawn(&unit, Mix::Effects, 1, 0, None, Some(10.0));
        let lost = DeviceEffect::new("lost-samples", &[], &[("share", 0.05)]).expect("a known effect");
        let plant = DevicePlant { effects: vec![lost], ..plant };
        let recording = plant.record(true);
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join(if unit.wire == Wire::Mm510 { "link.log" } else { "link.bin" });
        fs::write(&path, &recording.link).expect("written");
        let output = geu().args(["decode", "--format", "summary", "--device", unit.name]).arg(&path).output();
        let text = String::from_utf8(output.expect("geu starts").stdout).expect("UTF-8");
        // The decoder knows no samples before the first, nor behind the last.
        let [first, last] = [0, recording.samples.len() - 1].map(|row| recording.samples[row].0);
        let expected = last - first + 1 - recording.samples.len() as u64;
        let line = text.lines().find(|line| line.starts_with("samples-lost")).expect("a count");
        assert_eq!(line.split_whitespace().nth(1), Some(&*expected.to_string()), "{}: {text}", unit.name);
    }
}

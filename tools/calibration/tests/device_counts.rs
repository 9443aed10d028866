//! Counts of described units.

use std::sync::Arc;

use geu_calibration::DeviceCountsReader;
use geu_model::attitude::{AttitudeRow, RecordedAttitude};
use geu_model::device::Device;
use geu_recording::{DeviceSample, ReferenceAttitude, Sink};

#[test]
fn a_part_of_a_recording_without_receive_times_stays_in_its_place() {
    let device = Device::from_name("tetrad").expect("a unit");
    let values = device.serial.as_ref().expect("a serial link").frames.values.len();
    let row = |node: u32| AttitudeRow { t_s: node.into(), angle_control_arcsec: [0.0; 3], theta_psi_rad: None };
    let truth = RecordedAttitude::new((0..5).map(row).collect()).expect("a truth");
    let reference = ReferenceAttitude::of_truth(0, Arc::new(truth));
    let start_ns = |first: u64| {
        let mut reader = DeviceCountsReader::new(&device, &reference);
        for number in first..first + 50 {
            reader.row(&DeviceSample { number, values: vec![0.0; values], ..DeviceSample::default() });
        }
        let recording = reader.finish(7_000_000_000).expect("a recording");
        assert!(!recording.is_timed);
        recording.counts.start_ns
    };
    assert_eq!(start_ns(0), 7_000_000_000);
    assert_eq!(start_ns(250), 7_000_000_000 + (250.0 * device.interval_s * 1e9) as i64);
}

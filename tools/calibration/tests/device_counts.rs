//! Counts of described units.

use std::sync::Arc;

use geu_calibration::DeviceCountsReader;
use geu_model::attitude::{AttitudeRow, RecordedAttitude};
use geu_model::device::Device;
use geu_protocol::capture::Timestamp;
use geu_recording::{DeviceSample, ReferenceAttitude, Sink};

/// A reference that rests.
fn rest() -> ReferenceAttitude {
    let row = |node: u32| AttitudeRow { t_s: node.into(), angle_control_arcsec: [0.0; 3], theta_psi_rad: None };
    ReferenceAttitude::of_truth(0, Arc::new(RecordedAttitude::new((0..5).map(row).collect()).expect("a truth")))
}

#[test]
fn a_part_of_a_recording_without_receive_times_stays_in_its_place() {
    let device = Device::from_name("tetrad").expect("a unit");
    let values = device.serial.as_ref().expect("a serial link").frames.values.len();
    let reference = rest();
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

#[test]
fn nodes_between_the_rows_of_a_table_have_the_angle_of_the_motion() {
    let description = "[device]\nname = \"Table\"\nsource = \"a test\"\ninterval_s = 0.05\noutput = \"rate\"\nrange_arcsec_s = 1e6\n\
        [[device.head]]\nname = \"X\"\ninput = [1.0, 0.0, 0.0]\n\
        [device.table]\ntime = { column = \"t\", unit = \"s\" }\nfields = [{ column = \"x\", head = \"X\", unit = \"arcsec/s\" }]\n";
    let device =
        Device::parse("table.toml", description, &|name| Err(format!("no file {name}"))).expect("a description");
    let reference = rest();
    let mut reader = DeviceCountsReader::new(&device, &reference);
    // A swing of 20 rows; the rows are longer than the interval of the nodes, so that these wander through them.
    let (row_ns, angle_arcsec) = (50_250_000, |t_s: f64| 1e4 * (std::f64::consts::TAU * t_s).cos());
    let end_s = |row: i64| (row * row_ns) as f64 * 1e-9;
    for row in 1..=400 {
        let arcsec = angle_arcsec(end_s(row)) - angle_arcsec(end_s(row - 1));
        let (time, values) = (Timestamp { t_ns: row * row_ns, digits: 9 }, vec![arcsec / end_s(1)]);
        reader.row(&DeviceSample { time: Some(time), number: row as u64, values, ..DeviceSample::default() });
    }
    let counts = reader.finish(0).expect("a recording").counts;
    // Without the rows at the ends, beside which one is missing. The first row begins an interval before its end.
    for node in 2..counts.len() - 2 {
        let t_s = counts.node_s[node] + end_s(1) - 0.05;
        let error_arcsec = counts.accumulated[0][node] - (angle_arcsec(t_s) - angle_arcsec(end_s(1) - 0.05));
        assert!(error_arcsec.abs() < 5.0, "{error_arcsec} at node {node}");
    }
}

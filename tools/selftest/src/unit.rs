//! The unit itself: resolution, timing, saturation, temperatures (Casteren §2).

use geu_protocol::Gyro;
use geu_protocol::field::unit_flag;

use super::estimate::settling;
use super::receiver::Row;
use super::{Estimate, Measurement};

pub const MEASUREMENTS: &[Measurement] = &[
    ("timing", |receiver| {
        let rows = receiver.listen(600.0);
        let (first, last, count) = (rows[0], rows[rows.len() - 1], (rows.len() - 1) as f64);
        let clock = last.sample.clock_count - first.sample.clock_count;
        // Instants are given to the nanosecond.
        let grain_s = 1e-9 / 6f64.sqrt();
        vec![Estimate::new((last.t_s - first.t_s) / count, grain_s / count), Estimate::new(clock as f64 / count, 0.0)]
    }),
    ("resolution", |receiver| {
        // GYRX turns with the sun, one count in 24 s.
        let rows = receiver.listen(7200.0);
        let counts = |row: &Row| row.counts[Gyro::X.index()];
        let steps: Vec<_> = rows.windows(2).filter(|pair| counts(&pair[1]) != counts(&pair[0])).collect();
        let smallest =
            steps.iter().map(|pair| (counts(&pair[1]) - counts(&pair[0])).abs()).fold(f64::INFINITY, f64::min);
        // A step falls anywhere between two samples.
        let place = |pair: &[Row]| 0.5 * (pair[0].reference_arcsec[0] + pair[1].reference_arcsec[0]);
        let (first, last) = (steps[0], steps[steps.len() - 1]);
        let counted = counts(&last[1]) - counts(&first[1]);
        let grain = (first[1].reference_arcsec[0] - first[0].reference_arcsec[0]) / 6f64.sqrt();
        vec![Estimate::new(smallest, 0.0), Estimate::new((place(last) - place(first)) / counted, grain / counted)]
    }),
    ("saturation", |receiver| {
        // Torquers to the end of the range, and a drift beyond it.
        let mut extreme = |gyro: Gyro, counts: i64, until_s: f64| {
            receiver.command("SELF_TEST", &[i64::from(gyro.bit()), counts, 4]);
            let rows = receiver.listen(until_s);
            let flagged = rows.iter().filter(|row| row.sample.gyro_flags & gyro.bit() << 4 != 0);
            let increments = flagged.map(|row| f64::from(row.sample.increments[gyro.index()]));
            Estimate::new(increments.max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or(f64::NAN), 0.0)
        };
        vec![extreme(Gyro::X, 32_767, 5.0), extreme(Gyro::Y, -32_768, 10.0)]
    }),
    ("heater", |receiver| {
        let centi = |row: &Row| f64::from(row.sample.sensor_centi_c);
        let settle = |rows: &[Row], level: f64| {
            let start_s = rows[0].t_s;
            let points: Vec<_> = rows.iter().map(|row| (row.t_s - start_s, centi(row) - level)).collect();
            settling(&points, 1000.0)[2].times(1.0 / 60.0)
        };
        let warm = receiver.listen(600.0);
        receiver.command("HEATER", &[0]);
        let cooling = receiver.listen(6600.0);
        receiver.command("HEATER", &[1]);
        let warming = receiver.listen(12_600.0);
        let left = cooling.iter().position(|row| row.sample.unit_flags & unit_flag("heater_in_band") == 0);
        // The band's edge lies between two readings, each rounded to 0.01 K.
        let edge = left.filter(|&index| index > 0).map(|index| [centi(&cooling[index - 1]), centi(&cooling[index])]);
        let band = edge.map_or(Estimate::new(f64::NAN, 0.0), |[before, after]| {
            Estimate::new(7000.0 - 0.5 * (before + after), (0.5 * (before - after)).hypot(0.5) / 3f64.sqrt())
        });
        let held = warm.iter().map(centi).sum::<f64>() / warm.len() as f64;
        vec![
            Estimate::new(held / 100.0, 0.01 / 12f64.sqrt()),
            band.times(0.01),
            settle(&cooling, 2000.0),
            settle(&warming, 7000.0),
        ]
    }),
    ("spin-up", |receiver| {
        receiver.command("GYRO_POWER", &[0]);
        receiver.listen(10.0);
        receiver.command("GYRO_POWER", &[0x0F]);
        let rows = receiver.listen(120.0);
        let valid = rows.iter().find(|row| row.sample.gyro_flags & 0x0F == 0x0F);
        // The first valid sample starts when the motor is synchronous; its row has the end time.
        let spun_up_s = valid.map_or(f64::NAN, |row| row.t_s - 0.5 - 10.0);
        vec![Estimate::new(spun_up_s, 0.5 / 12f64.sqrt())]
    }),
];

use geu_model::units::RAD_PER_DEG;

use super::*;

#[test]
fn rates_and_quaternions_of_one_turn_agree() {
    // 100″/s about Z.
    let rates: String = (1..=10).map(|row| format!("{}.{},0,0,100\n", row / 2, row % 2 * 5)).collect();
    let quaternions: String = (0..=10)
        .map(|row| {
            let half = f64::from(row) * 0.5 * 100.0 / ARCSEC_PER_RAD / 2.0;
            format!("{}.{},{},0,0,{}\n", row / 2, row % 2 * 5, half.cos(), half.sin())
        })
        .collect();
    let rates = ReferenceAttitude::parse("r", &format!("t_s,rate_x_arcsec_s,rate_y_arcsec_s,rate_z_arcsec_s\n{rates}"));
    let quaternions = ReferenceAttitude::parse("q", &format!("t_s,q_w,q_x,q_y,q_z\n{quaternions}"));
    for reference in [rates, quaternions] {
        let reference = reference.expect("a reference");
        assert_eq!(reference.start_ns, 0);
        let turned = reference.truth.at(5.0, &mut 0).0[2] - reference.truth.at(0.0, &mut 0).0[2];
        assert!((turned - 500.0).abs() < 1e-6, "{turned}");
    }
}

#[test]
fn a_quaternion_tells_the_sun_from_its_first_row_on() {
    let row = |row: u32| format!("{}.{},1,0,0,0,{},0\n", row / 2, row % 2 * 5, 90 + row);
    let text: String = (0..=10).map(row).collect();
    let reference = ReferenceAttitude::parse("q", &format!("t_s,q_w,q_x,q_y,q_z,theta_deg,psi_deg\n{text}"));
    let (_, start) = reference.expect("a reference").truth.at(0.0, &mut 0);
    assert!((start.theta_rad / RAD_PER_DEG - 90.0).abs() < 1e-9);
}

#[test]
fn a_sigma_column_states_the_error_of_each_attitude() {
    let parse = |titles: &str, values: [&str; 4]| {
        let rows = values.iter().enumerate().map(|(row, values)| format!("{row},1,0,0,0,{values}\n"));
        ReferenceAttitude::parse("f.csv", &format!("t_s,q_w,q_x,q_y,q_z,{titles}\n{}", rows.collect::<String>()))
    };
    let one = parse("sigma_arcsec", ["3", "30", "0", "3"]).expect("a reference");
    assert_eq!(one.sigma_arcsec, [[3.0; 3], [30.0; 3], [0.0; 3], [3.0; 3]]);
    let axes = "sigma_x_arcsec,sigma_y_arcsec,sigma_z_arcsec";
    let three = parse(axes, ["1,2,30"; 4]).expect("a reference");
    assert_eq!(three.sigma_arcsec, [[1.0, 2.0, 30.0]; 4]);
    assert!(parse("theta_deg", ["90"; 4]).expect("a reference").sigma_arcsec.is_empty());
    for (titles, values, part) in [
        ("sigma_arcsec", "-1", "line 3: sigma_arcsec: expected a sigma from 0 to 648000, got \"-1\""),
        ("sigma_arcsec", "1e6", "line 3: sigma_arcsec: expected a sigma from 0 to 648000, got \"1e6\""),
        ("sigma_arcsec", "", "line 3: sigma_arcsec: expected a number, got \"\""),
        ("sigma_arcsec", "inf", "line 3: sigma_arcsec: expected a number, got \"inf\""),
        (axes, "1,1,-2", "line 3: sigma_z_arcsec: expected a sigma from 0 to 648000, got \"-2\""),
        ("sigma_x_arcsec", "1", "line 1: header: expected the columns q_w, q_x, q_y, q_z beside either sigma_arcsec"),
        ("sigma_arcsec,sigma_x_arcsec", "1,1", "line 1: header: expected the columns q_w, q_x, q_y, q_z beside"),
    ] {
        // A good value in place of the bad one.
        let good = values.replace(['-', 'e'], "").replace("inf", "");
        let good = if good.is_empty() { "1" } else { good.as_str() };
        let message = parse(titles, [good, values, good, good]).expect_err(values).to_string();
        assert!(message.contains(part), "{part} not in {message}");
    }
    let rates = "t_s,rate_x_arcsec_s,rate_y_arcsec_s,rate_z_arcsec_s,sigma_arcsec\n1,0,0,0,1\n";
    let message = ReferenceAttitude::parse("f.csv", rates).expect_err("rates").to_string();
    assert!(message.contains("line 1: header: expected the columns q_w") && message.contains("rates state none"));
}

#[test]
fn errors_name_their_line() {
    let header = "t_s,rate_x_arcsec_s,rate_y_arcsec_s,rate_z_arcsec_s\n";
    let good = "1.0,0,0,0\n1.5,0,0,0\n2.0,0,0,0\n2.5,0,0,0\n";
    for (text, part) in [
        ("a,b\n1,2\n".to_owned(), "line 1: header: expected the columns t_s"),
        (String::new(), "q_w, q_x, q_y, q_z, got none"),
        (format!("{header}{good}x,0,0,0\n"), "line 6: t_s: expected a number, got \"x\""),
        (format!("{header}{good}3.0,0,,0\n"), "line 6: rate_y_arcsec_s: expected a number"),
        (format!("{header}{good}3.0,0\n"), "line: 6"),
        (format!("{header}{good}3.0,nan,0,0\n"), "line 6: rate_x_arcsec_s: expected a number, got \"nan\""),
        (format!("{header}{good}3.0,0,1e300,0\n"), "line 6: expected finite numbers, turns within 1e9 arcsec"),
        (format!("{header}{good}2.5,0,0,0\n"), "line 6: expected time to rise"),
        (format!("{header}{good}9.5,0,0,0\n"), "line 6: expected rows every 0.5 s or so, got a gap of 7 s"),
        (header.to_owned(), "expected at least 3 rows after the first, got 0"),
    ] {
        let message = ReferenceAttitude::parse("f.csv", &text).expect_err(&text).to_string();
        assert!(message.contains(part), "{part} not in {message}");
    }
}

fn read(text: &str) -> Result<ReferenceAttitude, TableError> {
    attitude("f.csv", RowReader::new(text.as_bytes()), Gaps::All { has_own_times: true })
}

/// Accumulated angle about Z, deg.
fn z_deg(reference: &ReferenceAttitude, t_s: f64) -> f64 {
    reference.truth.at(t_s, &mut 0).0[2] / 3600.0
}

#[test]
fn columns_of_any_name_order_unit_and_delimiter_state_the_same_turn() {
    let row = |t: i32| -> [f64; 4] {
        let half = f64::from(t) * RAD_PER_DEG / 2.0;
        [half.cos(), 0.0, 0.0, half.sin()]
    };
    let quaternions = |header: &str, order: [usize; 4], delimiter: &str| {
        let line = |t: i32| {
            let cells: Vec<String> = order.iter().map(|&part| row(t)[part].to_string()).collect();
            format!("{t}{delimiter}{}\n", cells.join(delimiter))
        };
        format!("{}\n{}", header.replace(',', delimiter), (0..=10).map(line).collect::<String>())
    };
    let rates = |header: &str, rate: f64| {
        let times = (1..=10).map(|t| format!("{}, 0, 0, {rate:e}\n", t * 1000));
        format!("# a rate table\n{header}\n{}", times.collect::<String>())
    };
    let rows = (0..10).map(|t| format!("{};{t}000;0;0;1\n", t + 1)).collect::<String>();
    for text in [
        quaternions("t_s,q_w,q_x,q_y,q_z", [0, 1, 2, 3], ","),
        quaternions("time_s,qz,qy,qx,qw", [3, 2, 1, 0], ";"),
        quaternions("timestamp_s,q0,q1,q2,q3", [0, 1, 2, 3], "\t"),
        quaternions("t_s,q1,q2,q3,q4", [1, 2, 3, 0], ","),
        rates("t_ms, rate_x_deg_s, rate_y_deg_s, rate_z_deg_s", 1.0),
        rates("time_ms, wx_rad_s, wy_rad_s, wz_rad_s", RAD_PER_DEG),
        rates("t_ms, omega_x_deg_h, omega_y_deg_h, omega_z_deg_h", 3600.0),
        format!("end_s;start_ms;angle_x_deg;angle_y_deg;angle_z_deg\n{rows}"),
    ] {
        let read = read(&text).unwrap_or_else(|error| panic!("{error}\n{text}"));
        assert_eq!((read.trials.len(), read.start_ns), (0, 0), "{text}");
        assert!((z_deg(&read, 7.25) - 7.25).abs() < 1e-9, "{}\n{text}", z_deg(&read, 7.25));
        assert_eq!(read.truth.gaps_s(), Vec::<[f64; 2]>::new());
    }
}

#[test]
fn known_turns_rest_and_gaps_are_as_stated() {
    let header = "start_s,end_s,angle_x_deg,angle_y_deg,angle_z_deg,sigma_deg";
    // A minute of rest, a turn, rest, an unknown motion of 2 s, a turn, rest.
    let rows = "0,60,0,0,0,0.001\n60,65,0,0,90,0.01\n65,70,0,0,0,0\n72,77,0,0,-45,0.01\n77,80,0,0,0,0\n";
    let turns = read(&format!("{header}\n{rows}")).expect("turns");
    let truth = &turns.truth;
    assert!(!turns.is_attitude);
    for (t_s, deg) in
        [(0.0, 0.0), (31.4, 0.0), (60.0, 0.0), (65.0, 90.0), (67.3, 90.0), (72.0, 90.0), (77.0, 45.0), (79.0, 45.0)]
    {
        assert!((z_deg(&turns, t_s) - deg).abs() < 1e-9, "{t_s}: {}", z_deg(&turns, t_s));
    }
    assert_eq!(truth.gaps_s(), [[70.0, 72.0]]);
    assert_eq!(
        [69.9, 70.0, 70.1, 71.9, 72.0, 90.0].map(|t_s| truth.is_known(t_s)),
        [true, true, false, false, true, true]
    );
    let sigma: Vec<f64> = turns.turn_sigma_arcsec.iter().map(|axes| axes[2]).collect();
    assert_eq!(sigma, [0.0, 3.6, 36.0, 0.0, 0.0, 36.0, 0.0]);
    // The same as rates, each with its own sigma.
    let rates =
        header.replace("angle_x_deg,angle_y_deg,angle_z_deg,sigma_deg", "wx_deg_s,wy_deg_s,wz_deg_s,sigma_deg_h");
    let rates = read(&format!("{rates}\n{}", rows.replace("90,", "18,").replace("-45,", "-9,"))).expect("rates");
    assert_eq!(z_deg(&rates, 65.0), 90.0);
    assert!((rates.turn_sigma_arcsec[2][0] - 0.05).abs() < 1e-12);
    assert_eq!(rates.truth.unknown_s().collect::<Vec<_>>(), [[70.0, 72.0]]);
    let parse = |header: &str| ReferenceAttitude::parse("f.csv", &format!("{header}\n{rows}"));
    assert!(parse(header).expect_err("sigmas").to_string().contains("rates state none"));
    let refused = parse(&header.replace("sigma", "note")).expect_err("gaps").to_string();
    assert_eq!(
        refused,
        "f.csv: line 5: expected rows every 5 s or so, got a gap of 2 s before 12 s since the first row; cut the file there"
    );
}

#[test]
fn dropouts_are_gaps_and_trials_follow_one_another() {
    let quaternion = |t: i32| match t {
        4 => "4,,,,\n".to_owned(),
        5 => "5,nan,NaN,0,0\n".to_owned(),
        _ => format!("{t},1,0,0,0\n"),
    };
    let text = format!("t_s,q_w,q_x,q_y,q_z\n{}", (0..=10).map(quaternion).collect::<String>());
    assert_eq!(read(&text).expect("attitudes").truth.gaps_s(), [[3.0, 6.0]]);
    let refused = ReferenceAttitude::parse("f.csv", &text).expect_err("a gap").to_string();
    assert!(refused.contains("line 8: expected rows every 1 s or so, got a gap of 3 s"), "{refused}");
    let rate = |t: i32| if t == 5 { "5,,,\n".to_owned() } else { format!("{t},0,0,2\n") };
    let rows: String = (1..=10).map(rate).collect();
    let rates = read(&format!("t_s,rate_x_deg_s,rate_y_deg_s,rate_z_deg_s\n{rows}")).expect("rates");
    assert_eq!(rates.truth.gaps_s(), [[4.0, 5.0]]);
    assert!((z_deg(&rates, 4.0) - 8.0).abs() < 1e-9 && (z_deg(&rates, 10.0) - 18.0).abs() < 1e-9);
    let rows: String = (1..=8).map(|t| format!("{t},0,0,1,{}\n{t},0,0,2,b\n", if t > 0 { "a" } else { "" })).collect();
    let text = format!("t_s,rate_x_deg_s,rate_y_deg_s,rate_z_deg_s,trial\n{rows}");
    let both = read(&text).expect("trials");
    // The second follows after ten seconds in which nothing turns: its own 0 s is 18 s.
    let trial =
        |name: &str, from_s: f64, moved_ns: i64| Trial { name: name.to_owned(), from_s, to_s: from_s + 8.0, moved_ns };
    assert_eq!(both.trials, [trial("a", 0.0, 0), trial("b", 18.0, 18_000_000_000)]);
    assert_eq!(both.truth.unknown_s().collect::<Vec<_>>(), [[8.0, 18.0]]);
    for (t_s, deg) in [(7.5, 7.5), (8.0, 8.0), (12.3, 8.0), (18.0, 8.0), (18.5, 9.0), (26.0, 24.0)] {
        assert!((z_deg(&both, t_s) - deg).abs() < 1e-9, "{t_s}: {}", z_deg(&both, t_s));
    }
    let refused = ReferenceAttitude::parse("f.csv", &text).expect_err("trials").to_string();
    assert_eq!(refused, "f.csv: line 3: trial: expected a single trial, got \"b\"");
}

#[test]
fn errors_of_other_columns_name_line_and_column() {
    let turns = "start_s,end_s,angle_x_deg,angle_y_deg,angle_z_deg";
    for (text, part) in [
        (format!("{turns}\n0,1,0,0,0\n2,2,0,0,0\n"), "line 3: start_s: expected a start before the end, got \"2\""),
        (
            format!("{turns}\n0,1,0,0,0\n0.5,2,0,0,0\n2,3,0,0,0\n"),
            "line 3: expected time to rise, got -0.5 s since the first row after a row at 0 s",
        ),
        (format!("{turns}\n0,1,0,0,0\n1,2,0,0,inf\n"), "line 3: angle_z_deg: expected a number, got \"inf\""),
        (
            format!("{turns},sigma_deg\n0,1,0,0,0,190\n"),
            "line 2: sigma_deg: expected a sigma from 0 to 180, got \"190\"",
        ),
        (format!("{turns},sigma_deg_s\n0,1,0,0,0,1\n"), "line 1: header: expected the columns q_w"),
        ("t_s,angle_x_deg,angle_y_deg,angle_z_deg\n0,1,0,0,0\n".to_owned(), "line 1: header: expected the columns t_s"),
        ("t_s,wx,wy,wz\n0,1,0,0,0\n".to_owned(), "line 1: header: expected the columns t_s"),
        (
            "t_s,wx_deg_s,wx_deg_s,wy_deg_s,wz_deg_s\n0,1,1,0,0\n".to_owned(),
            "the columns of the time and of the motion once each",
        ),
        ("t_s;qw;qx;qy;qz\n0;1;0;0;x\n".to_owned(), "line 2: qz: expected a number, got \"x\""),
        ("t_s,qw,qx,qy,qz\n0,0,0,0,0\n".to_owned(), "line 2: qw: expected a unit quaternion, got \"0\""),
        ("t_s,qw,qx,qy,qz\n-9223372036,1,0,0,0\n9223372036,1,0,0,0\n".to_owned(), "3 rows after the first, got 1"),
    ] {
        let message = read(&text).expect_err(&text).to_string();
        assert!(message.contains(part), "{part} not in {message}");
    }
}

#[test]
fn magnitudes_have_windows_or_the_rates_of_the_heads() {
    let device = Device::from_name("suchai3").expect("a known unit");
    let described = device.table.as_ref().and_then(|table| table.reference.as_ref());
    let rows = |text: &str| {
        let table = CsvTable::new("r.csv", RowReader::new(text.as_bytes())).expect("a table");
        MagnitudeColumns::find(&table, described).expect("magnitudes").rows(table).expect("rows")
    };
    // After a gap, and at the beginning, a row lasts for the median spacing; a trial has times of its own.
    let timed =
        rows("time_ms;trial;rate_mrad_s\n1000;a;1\n2000;a;1\n3500;a;1\n9000;a;1\n10000;a;1\n11000;a;1\n500;b;2\n");
    let windows_ms: Vec<(i64, i64)> =
        timed.iter().filter_map(|row| row.window_ns).map(|(start, end)| (start / 1_000_000, end / 1_000_000)).collect();
    let expected = [(0, 1000), (1000, 2000), (2000, 3500), (8000, 9000), (9000, 10_000), (10_000, 11_000), (-500, 500)];
    assert_eq!(windows_ms, expected);
    assert_eq!((timed[6].group.as_str(), timed[6].magnitude_arcsec_s), ("b", 2e-3 * ARCSEC_PER_RAD));
    let own = rows("start_us,end_s,rate_arcsec_s\n1500000,2,7\n");
    assert_eq!(own[0].window_ns, Some((1_500_000_000, 2_000_000_000)));
    let windows = rows("magrate,wx,wy,wz,day\n2,1,-1,0,first\n");
    let rates_arcsec_s = vec![3600.0, -3600.0, 0.0];
    let window =
        MagnitudeRow { window_ns: None, group: "first".to_owned(), rates_arcsec_s, magnitude_arcsec_s: 7200.0 };
    assert_eq!(windows, [window]);
    // Rates about the axes state more.
    let table = CsvTable::new("r.csv", RowReader::new(&b"t_s,rate_deg_s,wx_deg_s,wy_deg_s,wz_deg_s\n"[..]));
    assert!(MagnitudeColumns::find(&table.expect("a table"), described).is_none());
    let refused = ReferenceAttitude::parse("r.csv", "t_s,rate_deg_s\n1,2\n2,2\n").expect_err("no attitude").to_string();
    assert!(refused.starts_with("r.csv: line 1: header: expected the columns t_s"), "{refused}");
}

#[test]
fn the_motion_beside_a_jump_of_the_rate_is_exact() {
    // 3600″/s about X, from 0.503 s on −7200″/s; a gap after 0.7 s. The turn in each row has a sigma of 2″.
    let angle = |t_s: f64| 3600.0 * t_s.min(0.503) - 7200.0 * (t_s - 0.503).max(0.0);
    let row = |row: i32| {
        let [from_s, to_s] = [row - 1, row].map(|row| f64::from(row) * 0.01);
        format!("{from_s:.2},{to_s:.2},{:.9},0,0,2\n", angle(to_s) - angle(from_s))
    };
    let text: String = (1..=70).chain(80..=120).map(row).collect();
    let titles = "start_s,end_s,angle_x_arcsec,angle_y_arcsec,angle_z_arcsec,sigma_arcsec\n";
    let text = titles.to_owned() + &text;
    let table = CsvTable::new("t.csv", RowReader::new(text.as_bytes())).expect("a table");
    let read = TrialTable::new("t.csv", table, Gaps::All { has_own_times: false })
        .and_then(TrialTable::read)
        .expect("a reference");
    let mut near = 0;
    for t_s in (1..690).map(|row| f64::from(row) * 1e-3) {
        let found = read.truth.at(t_s, &mut near).0[0];
        assert!((found - angle(t_s)).abs() < 1e-6, "{t_s}: {found} {}", angle(t_s));
    }
    assert_eq!(read.truth.unknown_s().count(), 1);
    assert_eq!(read.truth.rows().count(), read.turn_sigma_arcsec.len());
    // The two parts of a row have its variance together.
    let variance: f64 = read.turn_sigma_arcsec.iter().map(|sigma| sigma[0] * sigma[0]).sum();
    assert!((variance - 4.0 * 111.0).abs() < 1e-9, "{variance}");
}

#[test]
fn parts_of_a_reference_move_as_the_whole() {
    // A swing about Z and a turn about X, with a gap of 40 s.
    let row = |row: u32| {
        let t_s = f64::from(row) * 0.5;
        let attitude = UnitQuaternion::from_euler_angles(t_s * 1e-3, 0.0, 0.01 * (t_s * 0.3).sin());
        format!("{t_s},{},{},{},{},90,0,{t_s}\n", attitude.w, attitude.i, attitude.j, attitude.k)
    };
    let rows: String = (0..2000).filter(|row| !(900..980).contains(row)).map(row).collect();
    let text = format!("t_s,q_w,q_x,q_y,q_z,theta_deg,psi_deg,electronics_c\n{rows}");
    let table = |text: &str| {
        let table = CsvTable::new("f.csv", RowReader::new(std::io::Cursor::new(text.to_owned()))).expect("a table");
        TrialTable::new("f.csv", table, Gaps::OfAttitudes).expect("a reference")
    };
    let (whole, mut parts) = (table(&text).read().expect("a reference"), table(&text));
    let turn = |of: &ReferenceAttitude, ends_s: [f64; 2]| {
        let since_s = of.start_ns as f64 * 1e-9;
        let [from, to] = ends_s.map(|t_s| of.truth.at(t_s - since_s, &mut 0).0);
        std::array::from_fn::<f64, 3, _>(|axis| to[axis] - from[axis])
    };
    assert_eq!(parts.start_ns().expect("rows"), whole.start_ns);
    let mut from_s = 0.0;
    for end_s in [0.0, 130.25, 131.0, 455.0, 800.0, 999.5] {
        let part = parts.read_to((end_s * 1e9) as i64).expect("a part");
        assert!(part.truth.end_s() < end_s - part.start_ns as f64 * 1e-9 + 73.0, "{end_s}: rows behind the part");
        let mut at_s = from_s;
        while at_s < end_s {
            let ends_s = [from_s, at_s + 0.37];
            let [own, of_whole] = [&part, &whole].map(|reference| turn(reference, ends_s));
            let off_arcsec = (0..3).map(|axis| (own[axis] - of_whole[axis]).abs()).fold(0.0, f64::max);
            assert!(off_arcsec < 1e-6, "{off_arcsec} arcsec at {at_s} s of the part to {end_s} s");
            let [own, of_whole] = [&part, &whole].map(|of| of.truth.is_known(at_s - of.start_ns as f64 * 1e-9));
            assert_eq!(own, of_whole, "{at_s}");
            at_s += 7.3;
        }
        let last_c = part.celsius[0].last().expect("a temperature").1;
        assert!((last_c - (part.start_ns as f64 * 1e-9 + part.truth.end_s())).abs() < 1e-6, "{last_c}");
        from_s = end_s;
    }
    // A row of the end that is no row is an error of that part.
    let broken = format!("{text}x,1,0,0,0,90,0,20\n");
    let mut parts = table(&broken);
    assert!(parts.read_to(900_000_000_000).is_ok());
    for message in [parts.read_to(999_000_000_000).map(|_| ()), table(&broken).finish()] {
        let message = message.expect_err("a broken row").to_string();
        assert!(message.contains("line 1922: t_s: expected a number, got \"x\""), "{message}");
    }
}

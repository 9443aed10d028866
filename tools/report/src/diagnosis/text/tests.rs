//! Reports of diagnoses with given content.

use std::sync::Arc;

use geu_checks::Finding;
use geu_diagnosis::Thresholds;
use geu_diagnosis::measured::CHANNELS;
use geu_diagnosis::outcome::Gaps;
use geu_diagnosis::report::WIDTH;
use geu_diagnosis::residual_map::ResidualMap;
use geu_diagnosis::residual_stats::ResidualStats;
use geu_diagnosis::signature_bank::HypothesisFamily;
use geu_diagnosis::whitening::NoiseModel;
use geu_model::Configuration;
use geu_model::device::Device;
use geu_protocol::Gyros;

use super::*;

fn alternative(code: &str, delta_chi2: Option<f64>, test: Option<&str>) -> ReportedAlternative {
    ReportedAlternative {
        code: code.to_owned(),
        formula: None,
        gyros: Gyros::ALL,
        cosine: 0.99,
        delta_chi2,
        discriminating_test: test.map(str::to_owned),
        next_manoeuvre: None,
        hypothesis: None,
    }
}

fn entry(code: &str, class: Class, alternatives: Vec<ReportedAlternative>) -> DiagnosedEffect {
    DiagnosedEffect {
        code: code.to_owned(),
        gyros: Gyros::ALL.only(1),
        class,
        parameters: vec![EstimatedValue::new("arcsec_per_h".to_owned(), 17.4, 1.5)],
        chi2: Some(Chi2Fall { fall: 127.0, threshold: 24.0 }),
        held_out: Some([Some(40.0), Some(-1.0), None]),
        alternatives,
        ..DiagnosedEffect::default()
    }
}

fn diagnosis(verdict: Verdict, entries: Vec<DiagnosedEffect>, findings: usize) -> Diagnosis {
    let stats = ResidualStats { rms_arcsec: 1.4, max_arcsec: 6.5, after_30min_arcsec: 2.3, reduced_chi2: 1.07 };
    let gaps = Gaps { fitted: stats, held_out: stats };
    let map =
        ResidualMap { whole: std::array::from_fn(|_| [Some(-12.0); VARIABLES.len()]), segments: Default::default() };
    let finding = |index: usize| Finding {
        kind: "gap".to_owned(),
        place: format!("/a/directory/with/a/long/name/of/many/parts/link.log.gz: line {index}"),
        text: "samples are missing, and the sums begin anew after them, so that a window ends there".to_owned(),
    };
    let follows = |term: &str| FollowedTerm { term: term.to_owned(), score: 387.0 };
    let unexplained = (verdict == Verdict::Unexplained).then(|| Unexplained {
        gyros: Gyros::ALL.only(1),
        interval_s: [480.0, 11400.0],
        shape: "departures through most of it: 65 % of the two-minute averages stand out".to_owned(),
        follows: ["theta^3", "temperature*theta", "rate_x*rate_y", "abs(rate_x)*rate_z", "cos(orbit)"]
            .map(follows)
            .into(),
    });
    Diagnosis {
        verdict,
        entries,
        findings: (0..findings).map(finding).collect(),
        before: gaps,
        after: gaps,
        unexplained,
        configuration: Configuration::reference(),
        steps: Vec::new(),
        thresholds: Thresholds {
            on_grid_chi2: [24.0; HypothesisFamily::COUNT],
            between_chi2: [0.0; HypothesisFamily::COUNT],
            whiteness_statistic: 1.0,
        },
        windowed: Default::default(),
        segments: Vec::new(),
        segment_rms_arcsec: Default::default(),
        residual_maps: [map.clone(), map],
        left: Default::default(),
        lag_s: (0.0, 0.001),
        temperature_late_s: 0.0,
        noise: [NoiseModel { white: 0.01, angle_walk: 0.02, rate_walk: 2e-5, scale_walk: 0.0, flicker: 0.0 }; CHANNELS],
    }
}

/// Diagnoses with every kind of content.
fn every_kind() -> Vec<Diagnosis> {
    let test = "a Y-scan to 60° and back with an X-scan between would leave the cosine at 0.95, yet separate the two by 3.5 sigma";
    let group = (0..9).map(|index| alternative(&format!("scale-factor-nonlinearity-{index}"), Some(1.0), Some(test)));
    let wiring =
        DiagnosedEffect { chi2: None, held_out: None, ..entry("sign-inversion", Class::MissingEffect, vec![]) };
    let term = DiagnosedEffect {
        formula: Some("rate_x*abs(rate_y)*temperature".to_owned()),
        coefficient_unit: Some("arcsec/s/(arcsec/s)^2/K".to_owned()),
        ..entry("discovered", Class::MissingEffect, vec![alternative("lost-counts", Some(60.0), None)])
    };
    let entries = vec![
        entry("drift-settling", Class::MissingEffect, group.collect()),
        wiring,
        term,
        entry("drift-step", Class::MissingEffect, vec![alternative("reference-late", None, None)]),
        entry("drift", Class::Recalibration, Vec::new()),
    ];
    vec![
        diagnosis(Verdict::Consistent, Vec::new(), 0),
        diagnosis(Verdict::Consistent, vec![entry("drift", Class::Recalibration, Vec::new())], 1),
        diagnosis(Verdict::Explained, entries.clone(), 30),
        diagnosis(Verdict::Unexplained, entries, 30),
        diagnosis(Verdict::Unexplained, Vec::new(), 0),
    ]
}

#[test]
fn no_line_of_a_report_is_wider_than_the_width() {
    for diagnosis in every_kind() {
        for text in [summary(&diagnosis), whole(&diagnosis)] {
            let wide: Vec<&str> = text.lines().filter(|line| line.chars().count() > WIDTH).collect();
            assert!(wide.is_empty(), "{wide:#?}");
        }
    }
}

#[test]
fn values_and_the_gap_are_in_the_unit_of_the_device() {
    let mut own = diagnosis(Verdict::Consistent, vec![entry("drift", Class::Recalibration, Vec::new())], 0);
    own.configuration.device = Arc::new(Device::from_name("stim300").expect("a unit"));
    for text in [summary(&own), whole(&own)] {
        for part in
            ["17.4 ± 1.5 arcsec/h (0.00483 ± 0.00042 deg/h)", "\ngap, deg within ", "  0.000389 0.001806     0.000639"]
        {
            assert!(text.contains(part), "{part:?} not in\n{text}");
        }
    }
}

#[test]
fn a_summary_has_effect_certainty_alternatives_and_next_step() {
    let texts: Vec<String> = every_kind().iter().map(summary).collect();
    assert!(texts[0].starts_with("consistent: the model explains the recording"));
    assert!(
        texts[1].contains("\n   GYRY drift arcsec_per_h  changed by 17.4 ± 1.5 arcsec/h, 12 sigma\n"),
        "{}",
        texts[1]
    );
    assert!(texts[2].starts_with("explained: 4 effects are missing in the model"), "{}", texts[2]);
    for part in [
        "\n1. drift-settling on GYRY\n",
        "   arcsec_per_h  17.4 ± 1.5 arcsec/h\n",
        "   how sure      chi2 falls by 127; noise alone reaches 24 once in 400 recordings\n",
        "   held out      with it, 1 of 2 left-out thirds of the evidence are predicted better\n",
        "and 5 more\n",
        "   what next     to separate it from scale-factor-nonlinearity-0 on all gyros: a Y-scan",
        "   how sure      certain: an exact check of the data found it\n",
        "   what else     nothing else: the next best, lost-counts on all gyros, has a chi2 60 higher\n",
        "   what next     add it to the model: --out CONFIG writes it\n",
        "   and 10 more, which --verbose and --json list\n",
    ] {
        assert!(texts[2].contains(part), "{part:?} not in\n{}", texts[2]);
    }
    for part in ["   gyros       GYRY\n", "   when        480…11400 s\n", "   looks like  departures", "   what next "]
    {
        assert!(texts[4].contains(part), "{part:?} not in\n{}", texts[4]);
    }
}

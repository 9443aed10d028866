//! The page of `geu diagnose --html`: found effects, search, cross-validation and residual. Its charts are in `charts.rs`, the report for
//! a terminal in `text.rs`.

mod charts;
mod residual_map;
pub mod text;

use geu_diagnosis::model_selection::SelectionStep;
use geu_diagnosis::null_distribution::FALSE_ALARM_RATE;
use geu_diagnosis::outcome::{Chi2Fall, Class, DiagnosedEffect, Diagnosis, EstimatedValue, ReportedAlternative};
use geu_diagnosis::residual_stats::ResidualStats;
use geu_diagnosis::search::Candidate;
use geu_diagnosis::{Verdict, report};
use geu_model::units::AngleUnit;
use geu_protocol::template::Value;
use geu_protocol::{Gyro, Gyros, map};

use crate::page::{CHART_HINT, Provenance, escape, filled, fixed, html, prose, significant, table, table_if_any};
use charts::{axes_key, gap_bars, residuals, strength};

/// Candidates shown for a round.
const CANDIDATES: usize = 8;
/// Findings shown; a broken recording has thousands.
const FINDINGS: usize = 200;

/// Content of the page.
pub struct DiagnosisPage<'a> {
    pub diagnosis: &'a Diagnosis,
    pub provenance: Provenance<'a>,
}

impl DiagnosisPage<'_> {
    /// The page.
    pub fn html(&self) -> String {
        let diagnosis = self.diagnosis;
        let charts = |chart: fn(&Diagnosis, Gyro) -> String| -> String {
            diagnosis.gyros().into_iter().map(|gyro| chart(diagnosis, gyro)).collect()
        };
        let rounds = diagnosis.steps.iter().enumerate().map(|(index, round)| self.round(index + 1, round));
        let values = map! {
            verdict: self.verdict(),
            found: self.found(),
            recordings: FALSE_ALARM_RATE.recip(),
            window: diagnosis.window(),
            unit: self.angle().name,
            hint: CHART_HINT,
            is_unexplained: diagnosis.unexplained.is_some(),
            axes: axes_key(),
            residuals: charts(residuals),
            bars: charts(gap_bars),
            segments: diagnosis.segments.len() as u32,
            manoeuvres: self.manoeuvres(),
            map: self.residual_map(),
            rounds: rounds.collect::<Value>(),
            alternatives: self.alternatives(),
            thirds: self.thirds(),
            gap: self.gap(),
            findings: self.findings(),
            provenance: self.provenance.html(std::iter::empty()),
        };
        html("Diagnosis of a recording", &filled(include_str!("page.html"), &values))
    }

    fn angle(&self) -> AngleUnit {
        self.diagnosis.configuration.device.angle_unit()
    }

    /// A value with one sigma, in brackets with the device's unit of angles.
    fn value(&self, entry: &DiagnosedEffect, number: &EstimatedValue) -> String {
        let text = report::with_sigma(number) + &report::converted(entry, number, self.angle());
        escape(&text).replace('-', "−")
    }

    fn of_class(&self, class: Class) -> impl Iterator<Item = &DiagnosedEffect> {
        self.diagnosis.entries.iter().filter(move |entry| entry.class == class)
    }

    fn verdict(&self) -> String {
        let Diagnosis { verdict, unexplained, before, after, .. } = self.diagnosis;
        let angle = self.angle();
        let words = report::verdict(*verdict);
        let (word, why) = words.split_once(": ").unwrap_or((words, ""));
        let listed = |class: Class| -> Value {
            let entry = |entry: &DiagnosedEffect| {
                let facts =
                    report::facts(entry, angle).into_iter().map(|(label, value)| map! { label: label, value: value });
                map! { heading: report::heading(entry), facts: facts.collect::<Value>() }
            };
            self.of_class(class).map(entry).collect()
        };
        let left = unexplained.as_ref().map(|left| {
            let follows = left.follows.iter().map(|own| map! { term: own.term.as_str(), score: own.score });
            map! { gyros: left.gyros.names().join(", "), shape: left.shape.as_str(), interval_s: left.interval_s,
            follows: follows.collect::<Value>() }
        });
        let values = map! {
            is_bad: *verdict == Verdict::Unexplained,
            word: word,
            why: why,
            missing: listed(Class::MissingEffect),
            moved: listed(Class::Recalibration),
            left: left,
            rms: [before.fitted.rms_arcsec, after.fitted.rms_arcsec].map(|rms| rms / angle.arcsec),
            unit: angle.name,
        };
        filled(include_str!("verdict.html"), &values)
    }

    fn found(&self) -> Option<String> {
        let rows = self.diagnosis.entries.iter().flat_map(|entry| {
            entry.parameters.iter().enumerate().map(|(index, number)| {
                let is_first = index == 0;
                let once = |text: String| if is_first { text } else { String::new() };
                let class = if entry.class == Class::Recalibration { "moved" } else { "missing" };
                let chi2 = entry.chi2;
                let chi2 =
                    chi2.map_or("–".to_owned(), |Chi2Fall { fall, threshold }| format!("{fall:.0} ({threshold:.0})"));
                vec![
                    escape(&report::effect_name(entry)),
                    gyros(&entry.gyros),
                    once(class.to_owned()),
                    escape(&match &entry.coefficient_unit {
                        Some(unit) => format!("{}, {unit}", number.name),
                        None => number.name.clone(),
                    }),
                    self.value(entry, number),
                    once(format!("{} %", fixed(100.0 * entry.gap_share, 1).replace('+', ""))),
                    once(chi2),
                ]
            })
        });
        let header = ["effect", "gyros", "", "parameter", "value ± 1 σ", "of the gap", "χ² reduction (threshold)"];
        let caption = format!(
            "Found effects: values with one sigma, explained share of the gap, reduction of χ², and its threshold at one \
             false alarm in {:.0} recordings",
            FALSE_ALARM_RATE.recip()
        );
        table_if_any(&caption, &header, rows)
    }

    fn manoeuvres(&self) -> String {
        let ([before, after], angle) = (&self.diagnosis.segment_rms_arcsec, self.angle());
        let rows = self.diagnosis.segments.iter().enumerate().map(|(index, segment)| {
            let rms = |gyro: Gyro| {
                let [before, after] =
                    [before, after].map(|all| all.get(index).map_or(f64::NAN, |rms| rms[gyro.index()]));
                format!("{} → {}", angle_text(before, angle), angle_text(after, angle))
            };
            let mut row = vec![
                format!("{} {}", index + 1, escape(&segment.name)),
                format!("{:.0}", segment.from_s),
                format!("{:.0}", segment.to_s - segment.from_s),
            ];
            row.extend(self.diagnosis.gyros().into_iter().map(rms));
            row
        });
        let gyros = self.diagnosis.gyros();
        let header = ["manoeuvre", "start, s", "length, s"].into_iter().chain(gyros.iter().map(|gyro| gyro.name()));
        let header: Vec<&str> = header.collect();
        let caption = format!("Manoeuvres, and the residual within each before → after, {} rms", angle.name);
        table(&caption, &header, rows)
    }

    fn round(&self, number: usize, round: &SelectionStep) -> Value {
        let outcome = |candidate: &Candidate| match round.kept {
            Some(_) => format!("added {}", name_of(candidate)),
            None => format!("added {}, dropped after later additions", name_of(candidate)),
        };
        let added = round.added.and_then(|added| round.candidates.get(added));
        let outcome = added.map_or_else(|| "no candidate qualifies".to_owned(), outcome);
        let shown =
            round.candidates.iter().enumerate().filter(|(index, _)| *index < CANDIDATES || Some(*index) == round.added);
        let rows = shown.map(|(index, candidate)| {
            let change = &candidate.hypothesis;
            let threshold = self.diagnosis.thresholds.penalty(candidate.family, change);
            let parameters: Vec<String> = change
                .parameters()
                .iter()
                .map(|parameter| format!("{} {}", parameter.name, significant(parameter.value, 4)))
                .collect();
            let fall = format!("{:.0}", candidate.gain.chi2);
            let is_added = Some(index) == round.added;
            vec![
                if is_added { format!("<b>{}</b>", name_of(candidate)) } else { name_of(candidate) },
                gyros(&change.gyros),
                if candidate.gain.chi2 > threshold { format!("<b>{fall}</b>") } else { fall },
                format!("{threshold:.0}"),
                improvement(&candidate.held_out),
                match (is_added, round.kept) {
                    (true, Some(_)) => "added".to_owned(),
                    (true, None) => "added, dropped later".to_owned(),
                    _ => String::new(),
                },
                prose(&parameters.join(", ")),
            ]
        });
        let header = ["candidate", "gyros", "χ² reduction", "threshold", "held out", "", "with"];
        let candidates = table(&format!("Round {number}, the best candidates"), &header, rows);
        map! { number: number as u32, outcome: outcome, candidates: candidates }
    }

    fn alternatives(&self) -> Option<String> {
        let rows = self
            .of_class(Class::MissingEffect)
            .flat_map(|entry| entry.alternatives.iter().map(move |own| alternative_row(entry, own)));
        let header = ["found", "alternative", "gyros", "cosine", "χ² loss", "discriminating test"];
        table_if_any("Alternatives, the most similar first", &header, rows)
    }

    /// Cross-validation of the effects.
    fn thirds(&self) -> Option<String> {
        let rows = self.diagnosis.entries.iter().filter_map(|entry| {
            let thirds = entry.held_out?;
            let mut row = vec![escape(&report::effect_name(entry)), gyros(&entry.gyros)];
            row.extend(thirds.map(|better| improvement(&[better])));
            row.push(improvement(&thirds));
            Some(row)
        });
        let caption = "Cross-validation: improvement of each third of the evidence, predicted from the other two (reduction of −2 ln of its probability; a dash if one third determines the effect almost alone)";
        table_if_any(caption, &["found", "gyros", "first third", "second", "last", "sum"], rows)
    }

    fn gap(&self) -> String {
        let angle = self.angle();
        let row = |name: &str, gap: &ResidualStats| {
            let ResidualStats { rms_arcsec, max_arcsec, after_30min_arcsec, reduced_chi2, .. } = *gap;
            let mut row = vec![name.to_owned()];
            row.extend([rms_arcsec, max_arcsec, after_30min_arcsec].map(|value| angle_text(value, angle)));
            row.push(if reduced_chi2.is_finite() { format!("{reduced_chi2:.3}") } else { "–".to_owned() });
            row
        };
        let Diagnosis { before, after, .. } = self.diagnosis;
        let rows = [
            row("before, fitted", &before.fitted),
            row("before, held out", &before.held_out),
            row("after, fitted", &after.fitted),
            row("after, held out", &after.held_out),
        ];
        let caption = format!(
            "The gap, {} within windows of 30 min over all gyros: fitted, and each third predicted from the other two",
            angle.name
        );
        table(&caption, &["gap", "rms", "largest", "rms at the end", "χ² per degree of freedom"], rows)
    }

    fn findings(&self) -> Option<String> {
        let findings = &self.diagnosis.findings;
        let rows = findings
            .iter()
            .take(FINDINGS)
            .map(|found| vec![escape(&found.kind), escape(&found.place), prose(&found.text)]);
        let caption = format!("Findings of exact checks: {} of {}", findings.len().min(FINDINGS), findings.len());
        table_if_any(&caption, &["kind", "place", "finding"], rows)
    }
}

fn alternative_row(entry: &DiagnosedEffect, alternative: &ReportedAlternative) -> Vec<String> {
    let name = alternative.formula.as_ref().unwrap_or(&alternative.code);
    let width = 100.0 * alternative.cosine.abs().clamp(0.0, 1.0);
    vec![
        escape(&report::effect_name(entry)),
        escape(name),
        gyros(&alternative.gyros),
        format!(
            "{:.3} <span class=\"track\"><span class=\"bar\" style=\"width:{width:.0}%\"></span></span>",
            alternative.cosine
        ),
        alternative.delta_chi2.map_or_else(|| "the same signature".to_owned(), |behind| format!("{behind:.0}")),
        match (&alternative.discriminating_test, alternative.delta_chi2) {
            (Some(test), _) => prose(test),
            (None, Some(behind)) if behind >= geu_diagnosis::alternatives::AMBIGUITY_CHI2 => prose("this recording"),
            _ => prose("none in this recording"),
        },
    ]
}

/// Code or formula of a candidate.
fn name_of(candidate: &Candidate) -> String {
    let amplitude = &candidate.hypothesis.amplitude;
    escape(&amplitude.formula().map_or_else(|| amplitude.code(), |formula| format!("term {formula}")))
}

fn gyros(gyros: &Gyros) -> String {
    if gyros.is_all() { "all".to_owned() } else { gyros.names().join(", ") }
}

/// A number of arcsec in a unit of angles, or a dash.
fn angle_text(arcsec: f64, angle: AngleUnit) -> String {
    if arcsec.is_finite() { angle.fixed(arcsec, 2).replace('-', "−") } else { "–".to_owned() }
}

/// A number of sigmas in the colour of its strength.
fn in_sigmas(sigmas: Option<f64>) -> String {
    let Some(sigmas) = sigmas else { return "–".to_owned() };
    match strength(sigmas) {
        Some(class) => format!("<span class=\"heat {class}\">{}</span>", fixed(sigmas, 1)),
        None => fixed(sigmas, 1),
    }
}

/// Sum of the improvements of thirds; a dash if there is none.
fn improvement(thirds: &[Option<f64>]) -> String {
    if thirds.iter().all(Option::is_none) { "–".to_owned() } else { fixed(thirds.iter().flatten().sum(), 0) }
}

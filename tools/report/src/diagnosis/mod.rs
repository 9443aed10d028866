//! The page of `geu diagnose --html`: found effects, search, cross-validation and residual. Its charts are in `charts.rs`, the report for
//! a terminal in `text.rs`.

mod charts;
mod residual_map;
pub mod text;

use std::fmt::Write;

use geu_diagnosis::model_selection::SelectionStep;
use geu_diagnosis::null_distribution::FALSE_ALARM_RATE;
use geu_diagnosis::outcome::{Chi2Fall, Class, DiagnosedEffect, Diagnosis, ReportedAlternative};
use geu_diagnosis::residual_stats::ResidualStats;
use geu_diagnosis::search::Candidate;
use geu_diagnosis::{Verdict, report};
use geu_protocol::template::Value;
use geu_protocol::{Gyro, Gyros, map};

use crate::page::{CHART_HINT, Provenance, escape, filled, fixed, html, prose, significant, table};
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
        let mut body = String::from("<h1>Diagnosis of a recording</h1>\n");
        body += &self.verdict();
        body += &self.found();
        body += &self.residuals();
        body += &self.manoeuvres();
        body += &self.residual_map();
        body += &self.search();
        body += &self.alternatives();
        body += &self.cross_validation();
        body += &self.findings();
        body += &self.provenance.html(std::iter::empty());
        html("Diagnosis of a recording", &body)
    }

    fn of_class(&self, class: Class) -> impl Iterator<Item = &DiagnosedEffect> {
        self.diagnosis.entries.iter().filter(move |entry| entry.class == class)
    }

    fn verdict(&self) -> String {
        let Diagnosis { verdict, unexplained, before, after, .. } = self.diagnosis;
        let words = report::verdict(*verdict);
        let (word, why) = words.split_once(": ").unwrap_or((words, ""));
        let listed = |class: Class| -> Value {
            let entry = |entry: &DiagnosedEffect| {
                let facts = report::facts(entry).into_iter().map(|(label, value)| map! { label: label, value: value });
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
            rms: [before.fitted.rms_arcsec, after.fitted.rms_arcsec],
        };
        filled(include_str!("verdict.html"), &values)
    }

    fn found(&self) -> String {
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
                    escape(&report::with_sigma(number)).replace('-', "−"),
                    once(format!("{} %", fixed(100.0 * entry.gap_share, 1).replace('+', ""))),
                    once(chi2),
                ]
            })
        });
        let rows: Vec<_> = rows.collect();
        if rows.is_empty() {
            return "<h2>Found</h2>\n<p>No effect is missing, and the calibration has not moved.</p>\n".to_owned();
        }
        let header = ["effect", "gyros", "", "parameter", "value ± 1 σ", "of the gap", "χ² reduction (threshold)"];
        let caption = format!(
            "Found effects: values with one sigma, explained share of the gap, reduction of χ², and its threshold at one \
             false alarm in {:.0} recordings",
            FALSE_ALARM_RATE.recip()
        );
        format!("<h2>Found</h2>\n{}", table(&caption, &header, rows))
    }

    fn residuals(&self) -> String {
        let mut text = format!(
            "<h2>Residuals before and after</h2>\n<p>Measured less model, the accumulated angle in arcsec: with the \
             configuration as given, and with the found effects. Windows of {}, from line to line, start at zero, \
             also after a break; invalid sums are not drawn. The strip below shows \
             the motion, with the numbers of the manoeuvres.</p>\n{CHART_HINT}{}",
            self.diagnosis.window(),
            self.key()
        );
        for gyro in self.diagnosis.gyros() {
            text += &residuals(self.diagnosis, gyro);
        }
        text
    }

    /// Key of the colours of before and after.
    fn key(&self) -> String {
        let mut items = vec![("before", "as configured"), ("after", "with the found effects")];
        if self.diagnosis.unexplained.is_some() {
            items.push(("left", "left unexplained"));
        }
        let items = items.into_iter().map(|(class, words)| {
            format!("<span><svg viewBox=\"0 0 22 14\"><rect class=\"{class}\" width=\"22\" height=\"14\"/></svg>{words}</span>\n")
        });
        format!("<div class=\"key\">\n{}{}</div>\n", items.collect::<String>(), axes_key())
    }

    fn manoeuvres(&self) -> String {
        let mut text = String::from(
            "<h2>Manoeuvres</h2>\n<p>Root mean square of the residual within each manoeuvre, which starts at zero, before and \
             after.</p>\n<div class=\"figures dense\">\n",
        );
        for gyro in self.diagnosis.gyros() {
            text += &gap_bars(self.diagnosis, gyro);
        }
        let [before, after] = &self.diagnosis.segment_rms_arcsec;
        let rows = self.diagnosis.segments.iter().enumerate().map(|(index, segment)| {
            let rms = |gyro: Gyro| {
                let [before, after] =
                    [before, after].map(|all| all.get(index).map_or(f64::NAN, |rms| rms[gyro.index()]));
                format!("{} → {}", arcsec(before), arcsec(after))
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
        let caption = "Manoeuvres, and the residual within each before → after, arcsec rms";
        let _ = writeln!(
            text,
            "</div>\n<details>\n<summary>The {} manoeuvres in numbers</summary>\n{}</details>",
            self.diagnosis.segments.len(),
            table(caption, &header, rows)
        );
        text
    }

    fn search(&self) -> String {
        let mut text = format!(
            "<h2>Search</h2>\n<p>Each round tests every effect of the model on every set of gyros with every time course \
             beside the accepted ones, and adds the best if its reduction of χ² exceeds the threshold (one false alarm in {:.0} \
             recordings) and it passes cross-validation.</p>\n",
            FALSE_ALARM_RATE.recip()
        );
        if self.diagnosis.steps.is_empty() {
            text += "<p>No round was run.</p>\n";
        }
        for (index, round) in self.diagnosis.steps.iter().enumerate() {
            text += &self.round(index + 1, round);
        }
        text
    }

    fn round(&self, number: usize, round: &SelectionStep) -> String {
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
        let caption = format!("Round {number}: {}", outcome.replace("<b>", "").replace("</b>", ""));
        let header = ["candidate", "gyros", "χ² reduction", "threshold", "held out", "", "with"];
        format!("<h3>{caption}</h3>\n{}", table(&format!("Round {number}, the best candidates"), &header, rows))
    }

    fn alternatives(&self) -> String {
        let mut text = String::from("<h2>Alternatives</h2>\n");
        let rows: Vec<Vec<String>> = self
            .of_class(Class::MissingEffect)
            .flat_map(|entry| entry.alternatives.iter().map(move |own| alternative_row(entry, own)))
            .collect();
        if rows.is_empty() {
            return text + "<p>No found effect has an alternative.</p>\n";
        }
        text += "<p>Effects with similar signatures: the cosine of the two signatures on this motion, 1 if they are equal, and \
                 the loss of χ² reduction with the alternative in place of the effect.</p>\n";
        let header = ["found", "alternative", "gyros", "cosine", "χ² loss", "discriminating test"];
        text + &table("Alternatives, the most similar first", &header, rows)
    }

    fn cross_validation(&self) -> String {
        let mut text = String::from("<h2>Cross-validation</h2>\n");
        let rows: Vec<Vec<String>> = self
            .diagnosis
            .entries
            .iter()
            .filter_map(|entry| {
                let thirds = entry.held_out?;
                let mut row = vec![escape(&report::effect_name(entry)), gyros(&entry.gyros)];
                row.extend(thirds.map(|better| improvement(&[better])));
                row.push(improvement(&thirds));
                Some(row)
            })
            .collect();
        if !rows.is_empty() {
            let caption = "Cross-validation: improvement of each third of the evidence, predicted from the other two (reduction of −2 ln of its probability; a dash if one third determines the effect almost alone)";
            text += &table(caption, &["found", "gyros", "first third", "second", "last", "sum"], rows);
        }
        let row = |name: &str, gap: &ResidualStats| {
            let ResidualStats { rms_arcsec, max_arcsec, after_30min_arcsec, reduced_chi2, .. } = *gap;
            let mut row = vec![name.to_owned()];
            row.extend([rms_arcsec, max_arcsec, after_30min_arcsec].map(arcsec));
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
        let caption = "The gap, arcsec within windows of 30 min over all gyros: fitted, and each third predicted from the other two";
        text + &table(caption, &["gap", "rms", "largest", "rms at the end", "χ² per degree of freedom"], rows)
    }

    fn findings(&self) -> String {
        let findings = &self.diagnosis.findings;
        if findings.is_empty() {
            return "<h2>Exact checks</h2>\n<p>No lost, repeated, corrupt, stuck, swapped or inverted data, and no jump of \
                    time.</p>\n"
                .to_owned();
        }
        let rows = findings
            .iter()
            .take(FINDINGS)
            .map(|found| vec![escape(&found.kind), escape(&found.place), prose(&found.text)]);
        let caption = format!("Findings of exact checks: {} of {}", findings.len().min(FINDINGS), findings.len());
        format!("<h2>Exact checks</h2>\n{}", table(&caption, &["kind", "place", "finding"], rows))
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

/// A number of arcsec, or a dash.
fn arcsec(value: f64) -> String {
    if value.is_finite() { format!("{value:.2}").replace('-', "−") } else { "–".to_owned() }
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

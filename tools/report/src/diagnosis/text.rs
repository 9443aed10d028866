//! The report of `geu diagnose` on a terminal: for a first reader, or everything found. No line is wider than `WIDTH`.

use geu_diagnosis::Verdict;
use geu_diagnosis::next_manoeuvre::{NO_TEST, NextManoeuvre};
use geu_diagnosis::null_distribution::FALSE_ALARM_RATE;
use geu_diagnosis::outcome::{
    Chi2Fall, Class, DiagnosedEffect, Diagnosis, EstimatedValue, FollowedTerm, ReportedAlternative, Unexplained,
};
use geu_diagnosis::report::{alternative_name, facts, heading, labelled, on, quantity, verdict, wrapped};
use geu_diagnosis::residual_map::{SIGNIFICANT, VARIABLES, strongest};
use geu_hypothesis::amplitude::AmplitudeRef;
use geu_model::time_profile::{COURSES, TimeProfileSpec};
use geu_model::units::AngleUnit;
use geu_protocol::Gyro;

/// Number of variables, and of motion segments, listed for each gyro.
const PLACES: usize = 3;
/// Alternatives and findings that the summary names; the others are counted.
const NAMED_ALTERNATIVES: usize = 4;
const NAMED_FINDINGS: usize = 20;

/// Words for the time courses; another one is described as in the model.
const COURSE_WORDS: [(&str, &str); 7] = [
    ("-step", "that steps at time_s and stays"),
    ("-pulse", "that begins at time_s and ends after duration_s"),
    ("-ramp", "that grows evenly from the start"),
    ("-settling", "that begins at time_s and decays with time_constant_s"),
    ("-periodic", "that swings as a sine with period_s"),
    ("-temperature", "in proportion to the electronics temperature"),
    ("-temperature-rate", "in proportion to the rate of change of the electronics temperature"),
];

/// Label and value of a fact.
type Fact = (String, String);

fn fact(label: &str, value: impl Into<String>) -> Fact {
    (label.to_owned(), value.into())
}

fn of_class(diagnosis: &Diagnosis, class: Class) -> Vec<&DiagnosedEffect> {
    diagnosis.entries.iter().filter(|entry| entry.class == class).collect()
}

/// The report for a first reader: what was found, how sure, what else it could be, what to do next.
pub fn summary(diagnosis: &Diagnosis) -> String {
    let (missing, moved) = (of_class(diagnosis, Class::MissingEffect), of_class(diagnosis, Class::Recalibration));
    let angle = diagnosis.configuration.device.angle_unit();
    let mut text = wrapped("", &sentence(diagnosis, missing.len()));
    for (index, entry) in missing.iter().enumerate() {
        text += &format!("\n{}. {}\n{}", index + 1, title(entry), labelled(3, &effect_facts(entry, angle)));
    }
    if !moved.is_empty() {
        text += "\nchanged calibration, no missing effect: `geu diagnose --out CONFIG` writes the new values\n";
        text += &labelled(3, &moved.iter().flat_map(|entry| moved_facts(entry, angle)).collect::<Vec<_>>());
    }
    if let Some(left) = &diagnosis.unexplained {
        text += &format!("\nunexplained\n{}", labelled(3, &unexplained_facts(left)));
    }
    let findings = &diagnosis.findings;
    if !findings.is_empty() {
        text += "\nfindings of the exact checks\n";
        let shown = findings.iter().take(NAMED_FINDINGS);
        text += &shown.map(|own| finding(&own.kind, &own.place, &own.text)).collect::<String>();
        if let further @ 1.. = findings.len().saturating_sub(NAMED_FINDINGS) {
            text += &format!("   and {further} more, which --verbose and --json list\n");
        }
    }
    text += &gap(diagnosis);
    if let Some((_, _, next)) = diagnosis.next_manoeuvre() {
        let minutes = (next.duration_s / 60.0).ceil();
        text += &format!("\n--next-manoeuvre FILE writes the scenario of {minutes:.0} min as a configuration.");
    }
    text + "\n--verbose prints the whole chain of reasoning, --html FILE draws it.\n"
}

/// The verdict in plain words.
fn sentence(diagnosis: &Diagnosis, missing: usize) -> String {
    let them = if missing == 1 { "it" } else { "them" };
    let found = match missing {
        1 => "1 effect is missing in the model".to_owned(),
        count => format!("{count} effects are missing in the model"),
    };
    let gyros = diagnosis.unexplained.as_ref().map_or("some gyros".to_owned(), |left| on(&left.gyros));
    match (diagnosis.verdict, missing) {
        (Verdict::Consistent, _) => "consistent: the model explains the recording; what is left is noise.".to_owned(),
        (Verdict::Explained, 0) => {
            "explained: what the findings state is corrected, and what is left is noise.".to_owned()
        }
        (Verdict::Explained, _) => format!("explained: {found}; with {them} what is left is noise."),
        (Verdict::Unexplained, 0) => {
            format!(
                "unexplained: the recording differs from the model on {gyros}, and no effect of the model explains it."
            )
        }
        (Verdict::Unexplained, _) => {
            format!(
                "unexplained: {found}, yet with {them} {gyros} still differ, and no effect of the model explains that."
            )
        }
    }
}

/// Code and gyros of an entry.
fn title(entry: &DiagnosedEffect) -> String {
    let name = entry.formula.as_ref().map_or(entry.code.clone(), |formula| format!("term {formula}"));
    format!("{name} on {}", on(&entry.gyros))
}

/// Description of an effect.
fn words(entry: &DiagnosedEffect) -> Option<String> {
    if entry.formula.is_some() {
        return Some("a rate error in proportion to this product, outside the catalogue of effects".to_owned());
    }
    let mut all = AmplitudeRef::every().flat_map(AmplitudeRef::with_courses);
    let amplitude = all.find(|amplitude| amplitude.code() == entry.code)?;
    let course = |kind: usize| {
        let TimeProfileSpec { name, meaning, .. } = COURSES[kind];
        let words = COURSE_WORDS.iter().find(|(own, _)| own == name).map(|(_, words)| *words);
        format!(" {}", words.unwrap_or(meaning))
    };
    Some(amplitude.spec().title.to_owned() + &amplitude.kind.map_or(String::new(), course))
}

fn effect_facts(entry: &DiagnosedEffect, angle: AngleUnit) -> Vec<Fact> {
    let mut facts: Vec<Fact> = words(entry).map(|words| fact("what", words)).into_iter().collect();
    facts.extend(entry.parameters.iter().map(|number| fact(&number.name, quantity(entry, number, angle))));
    facts.push(fact("how sure", how_sure(entry)));
    facts.extend(held_out(entry).map(|words| fact("held out", words)));
    facts.push(fact("what else", what_else(entry)));
    facts.push(fact("what next", what_next(entry)));
    facts
}

fn how_sure(entry: &DiagnosedEffect) -> String {
    match entry.chi2 {
        Some(Chi2Fall { fall, threshold }) => {
            let recordings = FALSE_ALARM_RATE.recip();
            format!("chi2 falls by {fall:.0}; noise alone reaches {threshold:.0} once in {recordings:.0} recordings")
        }
        None => "certain: an exact check of the data found it".to_owned(),
    }
}

/// Prediction of each third of the evidence from the others.
fn held_out(entry: &DiagnosedEffect) -> Option<String> {
    let thirds: Vec<f64> = entry.held_out?.into_iter().flatten().collect();
    let (better, all) = (thirds.iter().filter(|&&third| third > 0.0).count(), thirds.len());
    Some(match all {
        0 => "no check: one place of the recording has all of the evidence".to_owned(),
        _ => format!("with it, {better} of {all} left-out thirds of the evidence are predicted better"),
    })
}

/// The alternatives that the recording does not exclude.
fn what_else(entry: &DiagnosedEffect) -> String {
    let (same, others): (Vec<_>, Vec<_>) = entry.alternatives.iter().partition(|other| other.is_indistinguishable());
    let name = |other: &&ReportedAlternative| alternative_name(entry, other);
    if !same.is_empty() {
        let named: Vec<String> = same.iter().take(NAMED_ALTERNATIVES).map(name).collect();
        let further = match same.len().saturating_sub(NAMED_ALTERNATIVES) {
            0 => String::new(),
            further => format!(" and {further} more"),
        };
        return format!("this recording does not exclude {}{further}", named.join(", "));
    }
    match others.first().and_then(|next| Some((next, next.delta_chi2?))) {
        Some((next, behind)) => format!("nothing else: the next best, {}, has a chi2 {behind:.0} higher", name(next)),
        None => "nothing else in the catalogue".to_owned(),
    }
}

/// The measurement that separates the effect from its alternatives, otherwise the correction.
fn what_next(entry: &DiagnosedEffect) -> String {
    let same = || entry.alternatives.iter().filter(|other| other.is_indistinguishable());
    if same().next().is_none() {
        return "add it to the model: --out CONFIG writes it".to_owned();
    }
    match same().filter_map(|other| Some((other, other.discriminating_test.as_ref()?))).min_by_key(|(other, test)| {
        let is_sure = other.next_manoeuvre.as_ref().is_some_and(NextManoeuvre::is_sure);
        (*test == NO_TEST, !is_sure)
    }) {
        Some((_, test)) if test == NO_TEST => format!("{test}; --out CONFIG writes the likeliest"),
        Some((other, test)) => format!("to separate it from {}: {test}", alternative_name(entry, other)),
        None => "record another motion, which may separate them; --out CONFIG writes the likeliest".to_owned(),
    }
}

/// Parameters of a changed calibration, a line each.
fn moved_facts(entry: &DiagnosedEffect, angle: AngleUnit) -> Vec<Fact> {
    let of = |number: &EstimatedValue| {
        let sure = number.sigma.map_or(String::new(), |sigma| format!(", {:.0} sigma", (number.value / sigma).abs()));
        let label = format!("{} {}", heading(entry).replace(':', ""), number.name);
        (label, format!("changed by {}{sure}", quantity(entry, number, angle)))
    };
    entry.parameters.iter().map(of).collect()
}

fn unexplained_facts(left: &Unexplained) -> Vec<Fact> {
    let [from_s, to_s] = left.interval_s;
    let mut facts = vec![
        fact("gyros", on(&left.gyros)),
        fact("when", format!("{from_s:.0}…{to_s:.0} s")),
        fact("looks like", &*left.shape),
    ];
    let terms: Vec<String> = left.follows.iter().map(|own| format!("{} ({:.0})", own.term, own.score)).collect();
    if !terms.is_empty() {
        facts.push(fact("follows", format!("{}, by the fall of chi2; each alone is not enough", terms.join(", "))));
    }
    let next = "compare the residual with the motion in --html FILE; check the reference attitude, its times, and the \
                findings; record the motion again to see if it repeats";
    facts.push(fact("what next", next));
    facts
}

fn finding(kind: &str, place: &str, text: &str) -> String {
    wrapped(&format!("   {kind}  "), &format!("{place}: {text}"))
}

/// Everything found, with all alternatives and the places of the residual.
pub fn whole(diagnosis: &Diagnosis) -> String {
    let angle = diagnosis.configuration.device.angle_unit();
    let mut text = verdict(diagnosis.verdict).to_owned() + "\n";
    for (class, title) in [
        (Class::MissingEffect, "missing in the model"),
        (Class::Recalibration, "changed calibration, no missing effect"),
    ] {
        let own = of_class(diagnosis, class);
        if !own.is_empty() {
            text += &format!("\n{title}\n");
        }
        for entry in own {
            text += &format!("{}{}", wrapped("  ", &heading(entry)), labelled(4, &facts(entry, angle)));
        }
    }
    if let Some(left) = &diagnosis.unexplained {
        let [from_s, to_s] = left.interval_s;
        let mut facts = vec![
            fact("gyros", on(&left.gyros)),
            fact("shape", &*left.shape),
            fact("interval", format!("{from_s:.0}…{to_s:.0} s")),
        ];
        let follows = |FollowedTerm { term, score }: &FollowedTerm| format!("{term} (fall of chi2 {score:.0})");
        facts.extend(left.follows.iter().map(|own| fact("follows", follows(own))));
        text += &format!("\nunexplained\n{}", labelled(2, &facts));
    }
    if !diagnosis.findings.is_empty() {
        text += "\nexact checks\n";
        text += &diagnosis.findings.iter().map(|own| finding(&own.kind, &own.place, &own.text)).collect::<String>();
    }
    let places: Vec<String> =
        diagnosis.gyros().into_iter().flat_map(|gyro| significant_terms(diagnosis, gyro)).collect();
    if !places.is_empty() {
        text += "\nsignificant variables of the residual, in sigmas before and after\n";
        text += &places.iter().map(|place| wrapped("  ", place)).collect::<String>();
    }
    text + &gap(diagnosis)
}

/// The residual angle before and after.
fn gap(diagnosis: &Diagnosis) -> String {
    let angle = diagnosis.configuration.device.angle_unit();
    let within = format!("gap, {} within {}", angle.name, diagnosis.window());
    let mut text = format!("\n{within:28}    rms      max   at the end   chi2/dof\n");
    for (name, gap) in [
        ("as configured", &diagnosis.before.fitted),
        ("with the effects found", &diagnosis.after.fitted),
        ("the same held out", &diagnosis.after.held_out),
    ] {
        text += &format!(
            "{name:24} {:>10} {:>8} {:>12} {:10.3}\n",
            angle.fixed(gap.rms_arcsec, 2),
            angle.fixed(gap.max_arcsec, 2),
            angle.fixed(gap.after_30min_arcsec, 2),
            gap.reduced_chi2
        );
    }
    text
}

/// The most significant variables of a gyro before the diagnosis, over the recording and in motion segments.
fn significant_terms(diagnosis: &Diagnosis, gyro: Gyro) -> Vec<String> {
    let ([before, after], index) = (&diagnosis.residual_maps, gyro.index());
    let whole = VARIABLES.iter().zip(&before.whole[index]).zip(&after.whole[index]);
    let along = whole.filter_map(|((name, sigmas), later)| Some((format!("along {name}"), (*sigmas)?, *later)));
    let segments = diagnosis.segments.iter().zip(&before.segments[index]).zip(&after.segments[index]);
    let within = segments.filter_map(|((segment, own), later)| {
        let (variable, sigmas) = strongest(own)?;
        let place = format!("in {}, {:.0} s ({})", segment.name, segment.from_s, VARIABLES[variable]);
        Some((place, sigmas, later[variable]))
    });
    // A whole number has no minus before a zero.
    let whole = |sigmas: f64| format!("{:+}", sigmas.round() as i64);
    let line = |(place, before, after): (String, f64, Option<f64>)| {
        let after = after.map_or(String::new(), |after| format!(" → {}", whole(after)));
        format!("{} {place} {}{after}", gyro.name(), whole(before))
    };
    [along.collect::<Vec<_>>(), within.collect()]
        .into_iter()
        .flat_map(|mut places| {
            places.retain(|(_, before, _)| before.abs() > SIGNIFICANT);
            places.sort_by(|one, other| other.1.abs().total_cmp(&one.1.abs()));
            places.into_iter().take(PLACES).map(line)
        })
        .collect()
}

#[cfg(test)]
mod tests;

//! Tables of a campaign, in Markdown.

use crate::campaign::{BlindCampaign, Group, TrialKind};
use crate::record::TrialRecord;
use crate::score::IsolationResult;
use geu_diagnosis::outcome::Verdict;

/// Quantile of the normal distribution for a two-sided interval of 95 %.
const NORMAL_95: f64 = 1.959_964;
const NOT_AVAILABLE: &str = "–";

const AMPLITUDES: &str = "injected | detected | isolated | isolated or in the right group, of those detected | \
                          additional false alarms | error over Cramér–Rao bound, rms | within one sigma";
const NOTHING: &str = "injected | false alarm | unexplained";
const UNKNOWN: &str = "injected | detected | its formula, or an equivalent one | another formula | no effect isolated | \
                       an effect of the catalogue, cosine to it 0.95 or less";

impl BlindCampaign {
    /// The results as tables in Markdown.
    pub fn tables(&self) -> String {
        let mut tables = [AMPLITUDES, NOTHING, UNKNOWN]
            .map(|header| format!("| {header} |\n|{}\n", "---|".repeat(header.split('|').count())));
        for group in &self.groups {
            let (table, cells) = match group.kind {
                TrialKind::Amplitude(_) => (0, group.amplitude_cells()),
                TrialKind::Nothing => (1, group.nothing_cells()),
                TrialKind::Unknown(_) => (2, group.unknown_cells()),
            };
            tables[table] += &format!("| {} | {} |\n", group.kind.name(), cells.join(" | "));
        }
        tables.join("\n")
    }
}

impl Group {
    fn share(&self, is: impl Fn(&TrialRecord) -> bool) -> String {
        share(self.count(is), self.runs.len())
    }

    fn count(&self, is: impl Fn(&TrialRecord) -> bool) -> usize {
        self.runs.iter().filter(|run| is(run)).count()
    }

    fn amplitude_cells(&self) -> Vec<String> {
        let detected = self.count(|run| run.isolation() >= IsolationResult::Unnamed);
        let isolated = |min| share(self.count(|run| run.isolation() >= min), detected);
        let outcomes = self.runs.iter().flat_map(|run| &run.injected);
        let sizes: Vec<_> = outcomes.filter_map(|outcome| outcome.size).collect();
        let squares: f64 = sizes.iter().map(|size| (size.error / size.bound).powi(2)).sum();
        let rms = match sizes.len() {
            0 => NOT_AVAILABLE.to_owned(),
            count => format!("{:.2}", (squares / count as f64).sqrt()),
        };
        let within = sizes.iter().filter(|size| size.error.abs() < size.sigma).count();
        vec![
            share(detected, self.runs.len()),
            isolated(IsolationResult::Right),
            isolated(IsolationResult::Group),
            self.share(|run| run.isolation() >= IsolationResult::Group && !run.false_names.is_empty()),
            rms,
            share(within, sizes.len()),
        ]
    }

    fn nothing_cells(&self) -> Vec<String> {
        let false_alarms = self.share(|run| !run.said.is_empty());
        vec![false_alarms, self.share(|run| run.verdict == Verdict::Unexplained)]
    }

    fn unknown_cells(&self) -> Vec<String> {
        vec![
            self.share(|run| run.isolation() >= IsolationResult::Unnamed),
            self.share(|run| run.isolation() >= IsolationResult::Group && !run.is_misnamed),
            self.share(|run| run.isolation() == IsolationResult::Wrong && !run.is_misnamed),
            self.share(|run| run.isolation() == IsolationResult::Unnamed),
            self.share(|run| run.is_misnamed),
        ]
    }
}

/// A share in percent with its 95 % interval (Wilson).
fn share(part: usize, whole: usize) -> String {
    if whole == 0 {
        return NOT_AVAILABLE.to_owned();
    }
    let (count, share, square) = (whole as f64, part as f64 / whole as f64, NORMAL_95 * NORMAL_95);
    let middle = (share + square / (2.0 * count)) / (1.0 + square / count);
    let half =
        NORMAL_95 / (1.0 + square / count) * (share * (1.0 - share) / count + square / (4.0 * count * count)).sqrt();
    let [low, high] = [middle - half, middle + half].map(|bound| 100.0 * bound.clamp(0.0, 1.0));
    format!("{part}/{whole}, {:.1} % ({low:.1}–{high:.1})", 100.0 * share)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_have_wilson_intervals() {
        // E. B. Wilson, 1927, as scipy.stats.binomtest(8, 10).proportion_ci(method="wilson") gives it.
        assert_eq!(share(8, 10), "8/10, 80.0 % (49.0–94.3)");
        assert_eq!(share(0, 200), "0/200, 0.0 % (0.0–1.9)");
        assert_eq!(share(0, 0), "–");
    }
}

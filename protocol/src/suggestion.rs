//! Suggestions in messages on unknown names: the most similar name, and a list of bounded length.

/// Names of a list that a message shows.
const SHOWN: usize = 30;
/// No name is longer; longer texts are not compared, because the time grows with the square of the length.
const LONGEST_NAME: usize = 80;
/// Names of lower similarity (Jaro and Winkler, 0 to 1) are not suggested.
const MIN_SIMILARITY: f64 = 0.8;

/// `did you mean `NAME`? ` with the name most similar to `got`; empty if none is similar.
///
/// ```
/// use geu_protocol::suggestion::did_you_mean;
/// assert_eq!(did_you_mean("PNIG", ["PING", "POLL"]), "did you mean `PING`? ");
/// assert_eq!(did_you_mean("nonsense", ["PING", "POLL"]), "");
/// ```
pub fn did_you_mean<S: AsRef<str>>(got: &str, names: impl IntoIterator<Item = S>) -> String {
    if got.len() > LONGEST_NAME {
        return String::new();
    }
    let wanted = got.to_lowercase();
    names
        .into_iter()
        .map(|name| (strsim::jaro_winkler(&name.as_ref().to_lowercase(), &wanted), name))
        .filter(|(similarity, _)| *similarity > MIN_SIMILARITY)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, name)| format!("did you mean `{}`? ", name.as_ref()))
        .unwrap_or_default()
}

/// Names with commas between them, the first `SHOWN` of many; `there is none` for an empty list.
pub fn listed<S: AsRef<str>>(names: impl IntoIterator<Item = S>) -> String {
    let mut names = names.into_iter();
    let shown: Vec<String> = names.by_ref().take(SHOWN).map(|name| name.as_ref().to_owned()).collect();
    match names.count() {
        _ if shown.is_empty() => "there is none".to_owned(),
        0 => shown.join(", "),
        more => format!("{}, and {more} more", shown.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_likeliest_name_is_offered_whatever_its_case() {
        let names = ["stuck-count", "bit-flip", "drop", "GYRX", "GYRY"];
        assert_eq!(did_you_mean("stuck-cuont", names), "did you mean `stuck-count`? ");
        assert_eq!(did_you_mean("bitflip", names), "did you mean `bit-flip`? ");
        assert_eq!(did_you_mean("gyrx", names), "did you mean `GYRX`? ");
        assert_eq!(did_you_mean("", names), "");
        assert_eq!(did_you_mean("explode", names), "");
        assert_eq!(did_you_mean(&"stuck-count".repeat(8), names), "", "too long for a name");
    }

    #[test]
    fn a_long_list_is_cut_and_says_by_how_much() {
        let names: Vec<String> = (1..=10_000).map(|number| format!("fault-{number}")).collect();
        let text = listed(&names);
        assert!(text.starts_with("fault-1, fault-2, ") && text.ends_with("fault-30, and 9970 more"), "{text}");
        assert_eq!(listed(&names[..2]), "fault-1, fault-2");
        assert_eq!(listed::<&str>([]), "there is none");
    }
}

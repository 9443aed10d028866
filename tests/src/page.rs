//! Pages of results, read as anything that reads XML would.

/// Every tag opened is closed in its turn, every attribute quoted, every `&` an entity; gives the names of the tags, but for that
/// of the page's own script, which is in the page.
///
/// # Panics
/// If the page is not well-formed.
pub fn well_formed(page: &str) -> Vec<String> {
    let (before, rest) = page.split_once("<script>\n//<![CDATA[\n").expect("a script");
    let (_, after) = rest.split_once("]]>").expect("an end of the script");
    let page = before.to_owned() + after.strip_prefix("\n</script>").expect("an end of the script");
    let rest = page.strip_prefix("<!DOCTYPE html>").expect("a doctype");
    let (mut open, mut all): (Vec<String>, Vec<String>) = (Vec::new(), Vec::new());
    let mut parts = rest.split('<');
    assert_eq!(parts.next().map(str::trim), Some(""));
    for part in parts {
        let (tag, after) = part.split_once('>').unwrap_or_else(|| panic!("no end: <{part}"));
        assert!(!after.contains('>'), "stray >: {after}");
        for reference in after.split('&').skip(1).chain(tag.split('&').skip(1)) {
            assert!(["amp;", "lt;", "gt;", "quot;"].iter().any(|name| reference.starts_with(name)), "&{reference}");
        }
        if let Some(name) = tag.strip_prefix('/') {
            assert_eq!(open.pop().as_deref(), Some(name), "</{name}>");
            continue;
        }
        assert_eq!(tag.matches('"').count() % 2, 0, "<{tag}>");
        let outside: String = tag.trim_end_matches('/').split('"').step_by(2).collect();
        let (name, attributes) = outside.split_once(' ').unwrap_or((&outside, ""));
        assert!(attributes.split_whitespace().all(|attribute| attribute.ends_with('=')), "<{tag}>");
        all.push(name.to_owned());
        if !tag.ends_with('/') {
            open.push(name.to_owned());
        }
    }
    assert_eq!(open, Vec::<String>::new());
    all
}

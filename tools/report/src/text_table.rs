//! Text tables with columns of fixed width.

/// Formats a header and rows. `layout` has a word for each column with the separators between them: `<8` is left-aligned
/// with 8 characters, `>8` right-aligned.
pub(crate) fn text_table<const N: usize>(
    layout: &str,
    header: [&str; N],
    rows: impl IntoIterator<Item = [String; N]>,
) -> String {
    let mut text = String::new();
    for row in [header.map(str::to_owned)].into_iter().chain(rows) {
        let mut cells = row.into_iter();
        for (index, column) in layout.split(' ').enumerate() {
            text += if index > 0 { " " } else { "" };
            // Two separators enclose an empty word.
            let Some((align, width)) = column.split_at_checked(1) else { continue };
            let (cell, width) = (cells.next().unwrap_or_default(), width.parse().unwrap_or(0));
            text += &if align == "<" { format!("{cell:<width$}") } else { format!("{cell:>width$}") };
        }
        text.push('\n');
    }
    text
}

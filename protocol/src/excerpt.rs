//! Quotation of input in messages.

use std::borrow::Cow;

/// Bytes of a line or field that a message quotes at most: enough to recognise it, and one line of a log.
pub const MAX_QUOTED: usize = 200;

/// Quotes a text: all of it, or its first [`MAX_QUOTED`] bytes and its length.
///
/// ```
/// use geu_protocol::excerpt::excerpt;
/// assert_eq!(excerpt("0.5,x"), "0.5,x");
/// assert_eq!(excerpt(&"9".repeat(1000)), format!("{}… (1000 bytes)", "9".repeat(200)));
/// ```
pub fn excerpt(text: &str) -> Cow<'_, str> {
    if text.len() <= MAX_QUOTED {
        return Cow::Borrowed(text);
    }
    let end = (0..=MAX_QUOTED).rev().find(|&end| text.is_char_boundary(end)).unwrap_or(0);
    Cow::Owned(format!("{}… ({} bytes)", &text[..end], text.len()))
}

/// Quotes a name from an input, with escapes in place of characters that a terminal would obey.
///
/// ```
/// use geu_protocol::excerpt::excerpt_of_name;
/// assert_eq!(excerpt_of_name(b"can0"), "can0");
/// assert_eq!(excerpt_of_name(b"a\x1b[31m\xff"), "a\\u{1b}[31m\u{fffd}");
/// ```
pub fn excerpt_of_name(name: &[u8]) -> String {
    excerpt(&String::from_utf8_lossy(name).escape_debug().to_string()).into_owned()
}

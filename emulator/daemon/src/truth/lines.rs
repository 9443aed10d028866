//! Splits a stream of bytes into lines of limited length.

/// Maximum length of a line, byte.
const MAX_LINE: usize = 64 * 1024;

/// Assembles lines from bytes.
#[derive(Debug, Default)]
pub(super) struct Lines {
    /// The start of an incomplete line.
    partial: Vec<u8>,
    /// The line is too long and is discarded.
    is_too_long: bool,
    /// Number of lines.
    pub count: u64,
}

impl Lines {
    /// Adds bytes. Calls `on_line` for each line that ends in them, except empty ones: number from 1, and text or error.
    pub fn push(&mut self, bytes: &[u8], mut on_line: impl FnMut(u64, Result<&str, String>)) {
        for part in bytes.split_inclusive(|&byte| byte == b'\n') {
            self.is_too_long |= self.partial.len() + part.len() > MAX_LINE;
            if !self.is_too_long {
                self.partial.extend_from_slice(part);
            }
            if part.ends_with(b"\n") {
                self.end(&mut on_line);
            }
        }
    }

    /// Ends a line without a line break, such as the last one of a datagram.
    pub fn end(&mut self, mut on_line: impl FnMut(u64, Result<&str, String>)) {
        self.count += 1;
        if std::mem::take(&mut self.is_too_long) {
            on_line(self.count, Err(format!("expected a line of {MAX_LINE} bytes at most, got a longer one")));
        } else {
            match str::from_utf8(&self.partial).map(str::trim) {
                Ok("") => {}
                Ok(line) => on_line(self.count, Ok(line)),
                Err(_) => on_line(self.count, Err("expected text in UTF-8, got other bytes".to_owned())),
            }
        }
        self.partial.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn push(lines: &mut Lines, bytes: &[u8]) -> Vec<String> {
        let mut all = Vec::new();
        lines.push(bytes, |number, line| {
            all.push(format!("{number} {}", line.map_or_else(|error| error, str::to_owned)))
        });
        all
    }

    #[test]
    fn lines_are_assembled_from_any_fragments() {
        let mut lines = Lines::default();
        assert_eq!(push(&mut lines, b"one\r\n\ntw"), ["1 one"]);
        assert_eq!(push(&mut lines, b"o\nthree\xFF\nfour"), ["3 two", "4 expected text in UTF-8, got other bytes"]);
        let mut last = Vec::new();
        lines.end(|number, line| last.push((number, line.map(str::to_owned))));
        assert_eq!(last, [(5, Ok("four".to_owned()))]);
    }

    #[test]
    fn an_endless_line_is_discarded_and_the_next_is_read() {
        let mut lines = Lines::default();
        for _ in 0..1000 {
            assert!(push(&mut lines, &[b'x'; 1000]).is_empty());
            assert!(lines.partial.len() <= MAX_LINE);
        }
        let both = push(&mut lines, b"\nnext\n");
        assert!(both.len() == 2 && both[0].contains("65536 bytes at most") && both[1] == "2 next", "{both:?}");
    }
}

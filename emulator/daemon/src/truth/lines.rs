//! Lines out of a stream of bytes, however it was cut, and none longer than is reasonable.

/// A longer line is none, byte.
const LONGEST: usize = 64 * 1024;

/// Puts bytes together to lines.
#[derive(Debug, Default)]
pub(super) struct Lines {
    /// What came of the line that is not at its end.
    begun: Vec<u8>,
    /// The line is too long; nothing of it is kept.
    is_too_long: bool,
    /// Lines so far.
    pub count: u64,
}

impl Lines {
    /// Takes bytes, and tells each line that ends in them: its number from 1, and its text or why it is none. Empty lines are
    /// not told.
    pub fn take(&mut self, bytes: &[u8], mut tell: impl FnMut(u64, Result<&str, String>)) {
        for piece in bytes.split_inclusive(|&byte| byte == b'\n') {
            let room = LONGEST.saturating_sub(self.begun.len());
            self.is_too_long |= piece.len() > room;
            if !self.is_too_long {
                self.begun.extend_from_slice(piece);
            }
            if piece.ends_with(b"\n") {
                self.end(&mut tell);
            }
        }
    }

    /// Ends a line that has no end of its own, as the last of a datagram.
    pub fn end(&mut self, mut tell: impl FnMut(u64, Result<&str, String>)) {
        self.count += 1;
        if std::mem::take(&mut self.is_too_long) {
            tell(self.count, Err(format!("expected a line of {LONGEST} bytes at most, got a longer one")));
        } else {
            match str::from_utf8(&self.begun).map(str::trim) {
                Ok("") => {}
                Ok(line) => tell(self.count, Ok(line)),
                Err(_) => tell(self.count, Err("expected text in UTF-8, got other bytes".to_owned())),
            }
        }
        self.begun.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(lines: &mut Lines, bytes: &[u8]) -> Vec<String> {
        let mut all = Vec::new();
        lines.take(bytes, |number, line| {
            all.push(format!("{number} {}", line.map_or_else(|wrong| wrong, str::to_owned)))
        });
        all
    }

    #[test]
    fn lines_come_whole_however_they_were_cut() {
        let mut lines = Lines::default();
        assert_eq!(told(&mut lines, b"one\r\n\ntw"), ["1 one"]);
        assert_eq!(told(&mut lines, b"o\nthree\xFF\nfour"), ["3 two", "4 expected text in UTF-8, got other bytes"]);
        let mut last = Vec::new();
        lines.end(|number, line| last.push((number, line.map(str::to_owned))));
        assert_eq!(last, [(5, Ok("four".to_owned()))]);
    }

    #[test]
    fn a_line_without_end_takes_no_memory_and_the_next_one_is_read() {
        let mut lines = Lines::default();
        for _ in 0..1000 {
            assert!(told(&mut lines, &[b'x'; 1000]).is_empty());
            assert!(lines.begun.len() <= LONGEST);
        }
        let both = told(&mut lines, b"\nnext\n");
        assert!(both.len() == 2 && both[0].contains("65536 bytes at most") && both[1] == "2 next", "{both:?}");
    }
}

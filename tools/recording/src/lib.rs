//! Opens any input, file or live link, and yields half seconds and defects.

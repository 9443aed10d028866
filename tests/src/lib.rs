//! Tests that need two crates or a process stand in `tests/`.

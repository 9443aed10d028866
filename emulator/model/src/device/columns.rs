//! Names of the columns of samples beside their values, in text and in archives. No value of a unit has such a name.

/// Columns of the time of a row: the instant to the microsecond, in seconds, its nanoseconds beyond the microsecond, the decimals of its source.
pub const TIME: [&str; 4] = ["time", "t_s", "time_rest_ns", "t_s_decimals"];
/// Likewise for the start of a row.
pub const START: [&str; 4] = ["start", "start_s", "start_rest_ns", "start_s_decimals"];
/// True if the time of a row is a receive time.
pub const IS_RECEIVED: &str = "is_received";
/// Number of a sample.
pub const NUMBER: &str = "number";
/// Trial of a row of a table.
pub const GROUP: &str = "group";

/// All of them.
pub fn all<'a>() -> impl Iterator<Item = &'a str> {
    TIME.into_iter().chain(START).chain([IS_RECEIVED, NUMBER, GROUP])
}

//! Enumerations with a name for each value.

/// Declares an enumeration with a name for each value.
#[macro_export]
macro_rules! named {
    ($(#[$meta:meta])* pub enum $type:ident { $($(#[$attribute:meta])* $variant:ident = $name:literal),* $(,)? }) => {
        $(#[$meta])*
        pub enum $type { $($(#[$attribute])* $variant),* }

        impl $type {
            /// All values, in order.
            pub const ALL: [$type; [$($name),*].len()] = [$($type::$variant),*];
            /// Names, in order.
            pub const NAMES: [&str; $type::ALL.len()] = [$($name),*];

            pub const fn name(self) -> &'static str {
                $type::NAMES[self as usize]
            }

            /// The value of that name.
            pub fn from_name(name: &str) -> Option<$type> {
                $type::ALL.into_iter().find(|value| value.name() == name)
            }
        }
    };
}

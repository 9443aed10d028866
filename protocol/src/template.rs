//! Templates filled with values.

pub use upon::{Engine, Value};

/// A [`Value`](crate::template::Value) with these keys.
#[macro_export]
macro_rules! map {
    ($($key:ident: $value:expr),* $(,)?) => {
        $crate::template::Value::from([$((stringify!($key), $crate::template::Value::from($value))),*])
    };
}

/// The filters that all templates have: `dec: n` and `plus: n` format a number with n decimals, `hex` one as two digits; `xml` is the text
/// in a document or an attribute of XML.
pub fn engine() -> Engine<'static> {
    let mut engine = Engine::new();
    engine.add_filter("dec", |number: f64, decimals: usize| format!("{number:.decimals$}"));
    engine.add_filter("plus", |number: f64, decimals: usize| format!("{number:+.decimals$}"));
    engine.add_filter("hex", |number: i64| format!("{number:02X}"));
    engine.add_filter(
        "id",
        |id: i64, is_extended: bool| if is_extended { format!("{id:08X}") } else { format!("{id:03X}") },
    );
    engine.add_filter("lower", str::to_lowercase);
    engine.add_filter("xml", |text: &str| {
        text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
    });
    engine.add_filter("constant", |text: &str| text.replace(' ', "_").to_uppercase());
    engine
}

/// # Panics
/// For a template with an error, or a value that it does not find.
pub fn filled(engine: &Engine, template: &str, values: &Value) -> String {
    let compiled = engine.compile(template).unwrap_or_else(|error| panic!("{error:#}"));
    compiled.render_from(engine, values).to_string().unwrap_or_else(|error| panic!("{error:#}"))
}

//! The page of archives against the columns.

use arrow_schema::{DataType, Field, TimeUnit};
use geu_archive::{Columns, DeviceColumns, UnitColumns};
use geu_model::device::{DEVICES, Device};

const PAGE: &str = include_str!("../../../docs/archives.md");

/// The type of a column in Parquet, in words.
fn kind(field: &Field) -> &'static str {
    match field.data_type() {
        DataType::Timestamp(TimeUnit::Microsecond, Some(_)) => "timestamp, us, UTC",
        DataType::Float64 => "double",
        DataType::Boolean => "bool",
        DataType::Int8 => "int8",
        DataType::Int16 => "int16",
        DataType::Int32 => "int32",
        DataType::Int64 => "int64",
        DataType::Utf8 => "string",
        other => panic!("{other}"),
    }
}

fn unit(field: &Field) -> &str {
    field.metadata().get("unit").map_or("", |unit| unit)
}

#[test]
fn the_page_has_the_columns_of_the_default_unit() {
    let row = |field: &Field| {
        let null = if field.is_nullable() { "yes" } else { "" };
        format!("| `{}` | {} | {} | {null} |\n", field.name(), kind(field), unit(field)).replace("  ", " ")
    };
    let schema = UnitColumns::default().schema();
    let rows: String = schema.fields().iter().map(|field| row(field)).collect();
    let table = format!("| column | type | unit | null |\n|---|---|---|---|\n{rows}");
    assert!(PAGE.contains(&table), "docs/archives.md: expected\n{table}");
}

#[test]
fn columns_of_described_units_have_types_and_units() {
    let of = |name: &str, column: &str| {
        let schema = DeviceColumns::new(&Device::from_name(name).expect("a unit")).schema();
        let field = schema.field_with_name(column).unwrap_or_else(|error| panic!("{name}: {error}"));
        (kind(field), unit(field).to_owned(), field.is_nullable())
    };
    assert_eq!(of("stim300", "X_deg_s"), ("double", "deg/s".to_owned(), true));
    assert_eq!(of("stim300", "X_valid"), ("bool", String::new(), true));
    assert_eq!(of("stim300", "sequence"), ("int64", "count".to_owned(), true));
    for (name, _) in DEVICES {
        let device = Device::from_name(name).expect("a unit");
        let schema = DeviceColumns::new(&device).schema();
        assert_eq!(schema.metadata()["geu.device"], *name);
        assert_eq!(schema.fields().len(), 6 + device.values().len(), "{name}");
        assert!(device.values().iter().all(|value| schema.field_with_name(&value.name).is_ok()), "{name}");
    }
}

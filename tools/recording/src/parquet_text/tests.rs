use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use flate2::write::GzEncoder;
use geu_model::device::Device;
use parquet::basic::{Compression, ZstdLevel};
use parquet::data_type::{BoolType, ByteArrayType, DoubleType, FloatType, Int32Type, Int64Type, Int96, Int96Type};
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::parser::parse_message_type;

use geu_protocol::capture::Foreign;

use super::*;
use crate::csv_table::TableError;
use crate::decoder::DecoderOptions;
use crate::defect::Defect;
use crate::device_decoder::DeviceDecoder;
use crate::input::InputError;
use crate::input_reader::{InputReader, Stop};
use crate::reference::ReferenceAttitude;
use crate::row::{DeviceSample, Sink};

/// Writes some rows of a column.
type Values = Box<dyn Fn(&mut SerializedRowGroupWriter<'_, File>, Range<usize>)>;

/// An optional column, by its type and name.
struct Field(&'static str, Values);

fn field<T: DataType>(name: &'static str, rows: Vec<Option<T::T>>) -> Field {
    let write = move |group: &mut SerializedRowGroupWriter<'_, File>, range: Range<usize>| {
        let mut column = group.next_column().expect("a column").expect("a column");
        let levels: Vec<i16> = rows[range.clone()].iter().map(|row| i16::from(row.is_some())).collect();
        let values: Vec<T::T> = rows[range].iter().flatten().cloned().collect();
        column.typed::<T>().write_batch(&values, Some(&levels), None).expect("written");
        column.close().expect("closed");
    };
    Field(name, Box::new(write))
}

/// Writes `count` rows in row groups of `group` rows.
fn write(path: &Path, fields: &[Field], count: usize, group: usize, compression: Compression) {
    let schema: String = fields.iter().map(|field| format!("optional {};", field.0)).collect();
    let schema = Arc::new(parse_message_type(&format!("message rows {{ {schema} }}")).expect("a schema"));
    let properties = Arc::new(WriterProperties::builder().set_compression(compression).build());
    let file = File::create(path).expect("a file");
    let mut writer = SerializedFileWriter::new(file, schema, properties).expect("a writer");
    for start in (0..count).step_by(group) {
        let mut rows = writer.next_row_group().expect("a row group");
        fields.iter().for_each(|field| field.1(&mut rows, start..count.min(start + group)));
        rows.close().expect("closed");
    }
    writer.close().expect("closed");
}

/// The text of a file, with commas.
fn text(path: &Path) -> io::Result<String> {
    let mut text = String::new();
    open_table(File::open(path)?)?.reader.read_to_string(&mut text)?;
    Ok(text.replace(SEPARATOR, ","))
}

/// Rows, and defects as text.
#[derive(Default, Debug)]
struct Rows(Vec<DeviceSample>, Vec<String>);

impl Sink<DeviceSample> for Rows {
    fn row(&mut self, row: &DeviceSample) {
        self.0.push(row.clone());
    }

    fn defect(&mut self, defect: &Defect) {
        self.1.push(format!("{:?} {:?} {:?}", defect.place, defect.kind, defect.bytes));
    }
}

fn decoded(device: &str, path: &Path) -> Result<Rows, InputError> {
    let device = Device::from_name(device).expect("a unit");
    let (options, mut rows) = (DecoderOptions::default(), Rows::default());
    let mut reader = InputReader::with(DeviceDecoder::new(&device, &options), options, Stop::default());
    reader.read(path.to_str().expect("UTF-8"), &mut rows)?;
    reader.finish(&mut rows).1?;
    Ok(rows)
}

fn reference(path: &Path) -> Result<ReferenceAttitude, TableError> {
    ReferenceAttitude::read(path.to_str().expect("UTF-8"))
}

fn paths() -> (tempfile::TempDir, PathBuf, PathBuf) {
    let directory = tempfile::tempdir().expect("a directory");
    let (parquet, csv) = (directory.path().join("x.parquet"), directory.path().join("x.csv"));
    (directory, parquet, csv)
}

/// A Unix time in any type, four numbers and a name; 2500 rows, so that row groups have several batches.
fn telemetry() -> (Vec<Field>, usize, String) {
    let count = 2500;
    let rows = || 0..count as i64;
    let x = |row: i64| (row != 7).then(|| (row as f64 * 0.37).sin() * 300.0);
    let fields = vec![
        field::<Int64Type>(
            "int64 timestamp_s (TIMESTAMP(MICROS,false))",
            rows().map(|row| Some(1_693_838_903_250_001 + row * 1_000_000)).collect(),
        ),
        field::<DoubleType>("double wx_deg_s", rows().map(|row| x(row).map(|x| x / 100.0)).collect()),
        field::<Int32Type>("int32 gyro_x_lsb (INTEGER(16,true))", rows().map(|row| x(row).map(|x| x as i32)).collect()),
        field::<FloatType>("float gyro_y_lsb", rows().map(|row| Some(row as f32)).collect()),
        field::<Int64Type>("int64 gyro_z_lsb", rows().map(|row| Some(-row)).collect()),
        field::<ByteArrayType>("binary name (UTF8)", rows().map(|_| Some("a;b".into())).collect()),
    ];
    let cell = |cell: Option<String>| cell.unwrap_or_default();
    let lines = rows().map(|row| {
        let (wx, lsb) = (cell(x(row).map(|x| (x / 100.0).to_string())), cell(x(row).map(|x| (x as i32).to_string())));
        format!("{}.250001,{wx},{lsb},{row},{},a;b\n", 1_693_838_903 + row, -row)
    });
    let titles = "timestamp_s,wx_deg_s,gyro_x_lsb,gyro_y_lsb,gyro_z_lsb,name\n";
    (fields, count, std::iter::once(titles.to_owned()).chain(lines).collect())
}

#[test]
fn telemetry_is_decoded_as_its_csv_twin_with_any_compression() {
    let (_directory, parquet, csv) = paths();
    let (fields, count, twin) = telemetry();
    fs::write(&csv, twin).expect("written");
    let expected = decoded("suchai3", &csv).expect("rows");
    assert_eq!((expected.0.len(), expected.1.len()), (count, 1));
    // As text, in which the output that is not known equals itself.
    let expected = format!("{expected:?}");
    for (compression, group) in [
        (Compression::UNCOMPRESSED, 1),
        (Compression::SNAPPY, 1500),
        (Compression::ZSTD(ZstdLevel::default()), count),
        (Compression::GZIP(Default::default()), count),
        (Compression::LZ4_RAW, 1024),
    ] {
        write(&parquet, &fields, count, group, compression);
        assert_eq!(format!("{:?}", decoded("suchai3", &parquet).expect("rows")), expected, "{compression}");
    }
}

#[test]
fn a_reference_is_that_of_its_csv_twin() {
    let (_directory, parquet, csv) = paths();
    let half = |row: i64| (row as f64 * 1e-3).sin_cos();
    let fields = [
        field::<DoubleType>("double t_s", (0..50).map(|row| Some(f64::from(row) * 0.1)).collect()),
        field::<DoubleType>("double q_w", (0..50).map(|row| Some(half(row).1)).collect()),
        field::<DoubleType>("double q_x", (0..50).map(|row| Some(half(row).0)).collect()),
        field::<BoolType>("boolean q_y", vec![Some(false); 50]),
        field::<Int32Type>("int32 q_z", vec![Some(0); 50]),
    ];
    write(&parquet, &fields, 50, 20, Compression::SNAPPY);
    let rows = (0..50).map(|row| format!("{},{},{},0,0\n", row as f64 * 0.1, half(row).1, half(row).0));
    fs::write(&csv, format!("t_s,q_w,q_x,q_y,q_z\n{}", rows.collect::<String>())).expect("written");
    let (one, other) = (reference(&parquet).expect("a reference"), reference(&csv).expect("a reference"));
    assert_eq!(format!("{one:?}"), format!("{other:?}"));
}

#[test]
fn every_type_has_its_text() {
    let (_directory, parquet, _) = paths();
    let mut time = Int96::new();
    time.set_data(1_000, 0, 2_440_589);
    let fields = [
        field::<BoolType>("boolean b", vec![Some(true), None]),
        field::<Int32Type>("int32 d (DECIMAL(9,2))", vec![Some(-5), Some(12_345)]),
        field::<Int32Type>("int32 u (UINT_32)", vec![Some(-1), Some(7)]),
        field::<Int32Type>("int32 day (DATE)", vec![Some(19_604), None]),
        field::<Int64Type>("int64 t (TIMESTAMP(MILLIS,true))", vec![Some(1_693_838_903_250), Some(-1)]),
        field::<Int64Type>("int64 n (TIMESTAMP(NANOS,true))", vec![Some(1), None]),
        field::<Int96Type>("int96 old", vec![Some(time), None]),
        field::<FloatType>("float f", vec![Some(0.1), Some(f32::NAN)]),
        field::<DoubleType>("double x", vec![Some(0.1), Some(-0.0)]),
        field::<ByteArrayType>("binary s (UTF8)", vec![Some("a\"\n\u{1f}b".into()), Some("".into())]),
        field::<ByteArrayType>("binary big (DECIMAL(30,3))", vec![Some(vec![0xFF, 0x38].into()), None]),
    ];
    write(&parquet, &fields, 2, 2, Compression::SNAPPY);
    let expected = "b,d,u,day,t,n,old,f,x,s,big\n\
        1,-0.05,4294967295,19604 days,1693838903250 ms,1 ns,86400000001000 ns,0.1,0.1,a   b,-0.200\n\
        ,123.45,7,,-1 ms,,,NaN,-0,,\n";
    assert_eq!(text(&parquet).expect("text"), expected);
}

#[test]
fn what_cannot_be_read_is_refused_with_its_place() {
    let (directory, parquet, _) = paths();
    let rate = |name| field::<DoubleType>(name, vec![Some(0.0), None, Some(0.0)]);
    let name = || field::<ByteArrayType>("binary t_s (UTF8)", vec![Some("noon".into()); 3]);
    let t_s = || field::<DoubleType>("double t_s", vec![Some(0.0), Some(1.0), Some(2.0)]);
    let rates = || [rate("double rate_x_deg_s"), rate("double rate_y_deg_s"), rate("double rate_z_deg_s")];
    for (time, message) in [
        (t_s(), "line 3: rate_x_deg_s: expected a number, got \"\""),
        (name(), "line 2: t_s: expected a number, got \"noon\""),
        (field::<BoolType>("boolean on", vec![None; 3]), "line 1: header: expected the columns t_s"),
    ] {
        let fields: Vec<Field> = std::iter::once(time).chain(rates()).collect();
        write(&parquet, &fields, 3, 1, Compression::SNAPPY);
        let error = reference(&parquet).expect_err(message).to_string();
        assert!(error.contains(message), "{message} not in {error}");
    }
    let whole = fs::read(&parquet).expect("a file");
    let gz = directory.path().join("x.parquet.gz");
    let mut packed = GzEncoder::new(File::create(&gz).expect("a file"), Default::default());
    packed.write_all(&whole).and_then(|()| packed.finish()).expect("written");
    let refused = Foreign::PARQUET.to_string();
    for error in
        [reference(&gz).expect_err("packed").to_string(), decoded("suchai3", &gz).expect_err("packed").to_string()]
    {
        assert!(error.contains(&refused), "{error}");
    }
    // A unit without a table.
    let error = decoded("mm5.10", &parquet).expect_err("no table").to_string();
    assert!(error.contains(&refused), "{error}");
}

#[test]
fn damaged_files_are_errors() {
    let (_directory, parquet, _) = paths();
    let (fields, ..) = telemetry();
    write(&parquet, &fields, 20, 10, Compression::SNAPPY);
    let whole = fs::read(&parquet).expect("a file");
    for length in (4..whole.len()).step_by(7) {
        fs::write(&parquet, &whole[..length]).expect("written");
        assert!(text(&parquet).is_err(), "{length}");
    }
    for place in 4..whole.len() {
        let mut damaged = whole.clone();
        damaged[place] ^= 0xFF;
        fs::write(&parquet, damaged).expect("written");
        // Values are not protected by a check.
        let _ = text(&parquet);
    }
}

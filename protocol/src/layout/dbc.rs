//! Messages and signals of a CAN database (DBC).

use can_dbc::{ByteOrder, Dbc, MessageId, MultiplexIndicator, SignalExtendedValueType, ValueType};

use super::number::{BitField, Coding};

/// Largest identifier of 11 bits.
const MAX_ID: u64 = 0x7FF;

/// The messages of a database.
#[derive(Debug, Clone)]
pub struct Database {
    pub messages: Vec<DatabaseMessage>,
}

/// A message of a database.
#[derive(Debug, Clone)]
pub struct DatabaseMessage {
    pub name: String,
    pub id: u32,
    /// True for an identifier of 29 bits.
    pub is_extended: bool,
    /// Length, byte.
    pub length: usize,
    pub signals: Vec<DatabaseSignal>,
}

/// A signal of a message.
#[derive(Debug, Clone)]
pub struct DatabaseSignal {
    pub name: String,
    /// `None` for more than 8 bytes, more than 53 bits of a whole number, or outside of the message.
    pub place: Option<BitField>,
    pub scale: f64,
    pub offset: f64,
    /// Unit, as the database has it.
    pub unit: String,
    /// Number that is sent where nothing else is known.
    pub start: f64,
    pub role: SignalRole,
}

/// Part of a signal in multiplexing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SignalRole {
    Plain,
    /// Selects the signals of a frame.
    Selector,
    /// Selects within the frames of another selector, which is not read.
    Nested,
    /// In the frames with this number of the selector.
    Selected(u64),
}

impl Database {
    /// Reads a database.
    ///
    /// # Errors
    /// Text that is none, in words.
    pub fn parse(text: &str) -> Result<Database, String> {
        // The parser takes only 16 bits of an identifier without bit 31.
        let ids = text
            .lines()
            .filter_map(|line| line.trim_start().strip_prefix("BO_ ")?.split_whitespace().next()?.parse().ok());
        if let Some(id) = ids.into_iter().find(|id: &u64| (MAX_ID + 1..1 << 31).contains(id)) {
            return Err(format!("expected an identifier up to {MAX_ID}, or with bit 31 set for 29 bits, got {id}"));
        }
        let database = Dbc::try_from(text).map_err(|error| error.to_string().replace('\n', " "))?;
        let message = |message: &can_dbc::Message| {
            let (id, is_extended) = match message.id {
                MessageId::Standard(id) => (u32::from(id), false),
                MessageId::Extended(id) => (id, true),
            };
            let length = message.size as usize;
            let is_nested = database.extended_multiplex.iter().any(|own| own.message_id == message.id)
                || message.signals.iter().any(|signal| {
                    matches!(signal.multiplexer_indicator, MultiplexIndicator::MultiplexorAndMultiplexedSignal(_))
                });
            let signals = message.signals.iter().map(|signal| {
                let kind = database.extended_value_type_for_signal(message.id, &signal.name);
                let coding = match (kind, signal.value_type) {
                    (Some(SignalExtendedValueType::IEEEfloat32Bit | SignalExtendedValueType::IEEEdouble64bit), _) => {
                        Coding::Float
                    }
                    (_, ValueType::Signed) => Coding::Signed,
                    (_, ValueType::Unsigned) => Coding::Unsigned,
                };
                let is_little_endian = signal.byte_order == ByteOrder::LittleEndian;
                let place = BitField::signal(signal.start_bit as usize, signal.size as usize, is_little_endian, coding);
                let start = database.resolved_signal_attribute(message.id, &signal.name, "GenSigStartValue");
                DatabaseSignal {
                    name: signal.name.clone(),
                    place: place.filter(|place| place.end() <= length && is_width(place)),
                    scale: signal.factor,
                    offset: signal.offset,
                    unit: signal.unit.clone(),
                    start: start.and_then(number).unwrap_or_default(),
                    role: match signal.multiplexer_indicator {
                        MultiplexIndicator::Plain => SignalRole::Plain,
                        MultiplexIndicator::Multiplexor => SignalRole::Selector,
                        MultiplexIndicator::MultiplexedSignal(_) if is_nested => SignalRole::Nested,
                        MultiplexIndicator::MultiplexedSignal(number) => SignalRole::Selected(number),
                        MultiplexIndicator::MultiplexorAndMultiplexedSignal(_) => SignalRole::Nested,
                    },
                }
            });
            DatabaseMessage { name: message.name.clone(), id, is_extended, length, signals: signals.collect() }
        };
        Ok(Database { messages: database.messages.iter().map(message).collect() })
    }
}

/// True for a width that a number can have.
fn is_width(place: &BitField) -> bool {
    match place.coding {
        Coding::Float => matches!(place.bits, 32 | 64),
        _ => place.bits <= BitField::MAX_EXACT_BITS,
    }
}

/// The number of an attribute, where it is one.
fn number(value: &can_dbc::AttributeValue) -> Option<f64> {
    match value {
        can_dbc::AttributeValue::Uint(value) => Some(*value as f64),
        can_dbc::AttributeValue::Int(value) => Some(*value as f64),
        can_dbc::AttributeValue::Double(value) => Some(*value),
        can_dbc::AttributeValue::String(_) => None,
    }
}

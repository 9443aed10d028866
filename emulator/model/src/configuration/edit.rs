//! Edits of a configuration's text that keep its comments and order.

use geu_protocol::excerpt::excerpt;
use toml_edit::{Array, ArrayOfTables, DocumentMut, Item, TableLike};

use super::Configuration;
use super::document::{ConfigText, ConfigurationError, locate};

impl Configuration {
    /// `text` with every override `PATH=VALUE` put in; comments and order stay. A path may go through lists by index
    /// (`manoeuvre.0.duration_s`).
    ///
    /// # Errors
    /// An override that is not `PATH=VALUE`, or has nothing to set.
    pub fn edited(name: &str, text: &str, overrides: &[String]) -> Result<String, ConfigurationError> {
        // The text was parsed before; only an override can be at fault here.
        let mut document: DocumentMut = match text.parse() {
            Ok(document) => document,
            Err(_) => return ConfigText::parse(name, text).map(|_| text.to_owned()),
        };
        for given in overrides {
            let refused = |message: String| locate("--set", given, None, message);
            // TOML would take what stands after a line break as another override, or as a table for it.
            if given.contains(['\n', '\r']) {
                return Err(refused(format!(
                    "expected PATH=VALUE without a line break, got {:?}; give --set once for each",
                    excerpt(given)
                )));
            }
            let quoted = given.split_once('=').map(|(path, value)| format!("{path} = {:?}", value.trim()));
            let parsed =
                given.parse::<DocumentMut>().or_else(|error| quoted.and_then(|text| text.parse().ok()).ok_or(error));
            match parsed {
                Ok(parsed) if given.contains('=') && !parsed.is_empty() => {
                    merge(document.as_table_mut(), parsed.as_table(), "").map_err(refused)?;
                }
                _ => return Err(refused(format!("expected PATH=VALUE, got {}", excerpt(given)))),
            }
        }
        Ok(document.to_string())
    }

    /// The text of a configuration with comments at the ends of lines, each behind the value at its path or behind the inline
    /// table with it. An existing comment stays before it.
    pub fn commented(text: &str, comments: &[(String, String)]) -> String {
        let Ok(mut document) = text.parse::<DocumentMut>() else { return text.to_owned() };
        for (path, comment) in comments {
            let mut keys = path.split('.');
            let mut item = keys.next().and_then(|key| document.get_mut(key));
            while let Some(found) = item {
                if let Item::Value(value) = found {
                    let decor = value.decor_mut();
                    let before = decor.suffix().and_then(|suffix| suffix.as_str()).unwrap_or_default().trim_end();
                    let comment = comment.replace(['\n', '\r'], " ");
                    let suffix = match before.trim_start() {
                        "" => format!(" # {comment}"),
                        _ if before.ends_with(&comment) => before.to_owned(),
                        _ => format!("{before}; {comment}"),
                    };
                    decor.set_suffix(suffix);
                    break;
                }
                item = keys.next().and_then(|key| found.get_mut(key));
            }
        }
        document.to_string()
    }
}

fn merge(base: &mut dyn TableLike, over: &dyn TableLike, path: &str) -> Result<(), String> {
    for (key, item) in over.iter() {
        let path = if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") };
        let Some(table) = item.as_table_like() else {
            base.insert(key, item.clone());
            continue;
        };
        if table.is_empty() {
            return Err(format!("expected {path}.NAME=VALUE, got nothing to set in {path}"));
        }
        let Some(existing) = base.get_mut(key) else {
            base.insert(key, item.clone());
            continue;
        };
        if let Some(length) =
            existing.as_array().map(Array::len).or(existing.as_array_of_tables().map(ArrayOfTables::len))
        {
            for (index, item) in table.iter() {
                let entry = index.parse().ok().and_then(|index| entry_mut(existing, index));
                let (Some(entry), Some(table)) = (entry, item.as_table_like()) else {
                    return Err(format!(
                        "expected {path}.INDEX.NAME=VALUE with an INDEX less than {length}, got {path}.{index}; a longer list is given whole, {path}=[…], or in the file"
                    ));
                };
                merge(entry, table, &format!("{path}.{index}"))?;
            }
        } else if let Some(existing) = existing.as_table_like_mut() {
            merge(existing, table, &path)?;
        } else {
            *existing = item.clone();
        }
    }
    Ok(())
}

/// The table at `index` of a list.
fn entry_mut(list: &mut Item, index: usize) -> Option<&mut dyn TableLike> {
    match list {
        Item::ArrayOfTables(tables) => tables.get_mut(index).map(|table| table as &mut dyn TableLike),
        list => list.as_array_mut()?.get_mut(index)?.as_inline_table_mut().map(|table| table as &mut dyn TableLike),
    }
}

//! The unit of a configuration: the name of a known one, or a description with the files that it names.

use std::sync::Arc;

use geu_protocol::suggestion::did_you_mean;
use serde_json::{Map, Value as Json, json};

use super::document::{Node, Read};
use super::tree::{Part, line, one, quoted};
use crate::device::{DEFAULT_DEVICE, DEVICES, Device, DeviceText};

const KEY: &str = "device";

/// The unit that a configuration names; it must be `asked`, if there is one.
///
/// # Errors
/// An unknown name, a description that is not valid, another unit than the one asked for.
pub(super) fn read(root: &Node, asked: Option<&Arc<Device>>) -> Read<Arc<Device>> {
    if !root.keys().contains(&KEY) {
        return Ok(asked.cloned().unwrap_or_else(Device::iras));
    }
    let device = match root.text(KEY) {
        Ok(DEFAULT_DEVICE) => (*Device::iras()).clone(),
        Ok(name) => Device::from_name(name).ok_or_else(|| {
            let names: Vec<&str> = DEVICES.iter().map(|(name, _)| *name).collect();
            let hint = did_you_mean(name, &names);
            root.error(KEY, format!("{hint}expected a known unit ({}), got {name}", names.join(", ")))
        })?,
        Err(refused) => described(&root.table(KEY).ok().flatten().ok_or(refused)?)?,
    };
    match asked {
        Some(asked) if **asked != device => {
            let differs = if asked.name == device.name { " with another description" } else { "" };
            let (asked, got) = (&asked.name, &device.name);
            Err(root.error(KEY, format!("expected a configuration of {asked}, got {got}{differs}")))
        }
        _ => Ok(Arc::new(device)),
    }
}

/// The unit of a description within a configuration.
fn described(node: &Node) -> Read<Device> {
    node.only(&["name", "text", "files"])?;
    let files = node.table("files")?;
    let file = |name: &str| {
        let text = files.as_ref().and_then(|files| files.text(name).ok());
        text.map(str::to_owned).ok_or_else(|| "no such file in the configuration".to_owned())
    };
    Device::parse(node.text("name")?, node.text("text")?, &file)
}

impl Part for &Device {
    fn read(&mut self, _node: &Node, _key: &str) -> Read<()> {
        Ok(())
    }

    fn show(&self, key: &str, complete: bool, text: &mut String) {
        let DeviceText { name, text: description, files } = &self.description;
        if self.is_iras() {
            return;
        }
        if complete {
            line!(text, "# The unit: a known one, or {{ name, text of its description, files that it names }}.");
        }
        if let Some(known) = self.known_name() {
            return line!(text, "{key} = {}", quoted(known));
        }
        let files: Vec<String> =
            files.iter().map(|(name, text)| format!("{} = {}", quoted(name), quoted(text))).collect();
        let files = if files.is_empty() { String::new() } else { format!(", files = {{ {} }}", files.join(", ")) };
        line!(text, "{key} = {{ name = {}, text = {}{files} }}", quoted(name), quoted(description));
    }

    fn schema(&self, key: &str) -> Map<String, Json> {
        let names: Vec<&str> = DEVICES.iter().map(|(name, _)| *name).collect();
        let files = json!({ "type": "object", "additionalProperties": { "type": "string" } });
        let text = json!({ "type": "string" });
        let described = json!({
            "type": "object", "additionalProperties": false, "required": ["name", "text"],
            "properties": { "name": text, "text": text, "files": files },
        });
        one(key, json!({ "description": "the unit", "oneOf": [{ "enum": names }, described] }))
    }
}

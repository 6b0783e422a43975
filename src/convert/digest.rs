//! The digest of a request that has an id: two requests with one id are the same if it is equal.

use std::collections::BTreeMap;

use jostle_proto::Request;
use serde_json::Value;

/// Below this every whole number is exactly a double.
const EXACT: f64 = 9_007_199_254_740_992.0;

/// A digest of a request, without the fields that may differ when it is sent again.
pub type Digest = [u8; 32];

/// The identity of a request that has an id.
pub struct RequestIdentity {
    /// The client that it names.
    pub client: Option<String>,
    /// Its id.
    pub request_id: String,
    /// Its digest.
    pub digest: Digest,
}

impl RequestIdentity {
    /// The identity of a request to `key`; `None` if it has no id.
    pub fn of(key: &str, request: &Request) -> Option<Self> {
        request.request_id.as_ref().map(|id| RequestIdentity {
            client: request.client.clone(),
            request_id: id.clone(),
            digest: digest(key, request),
        })
    }
}

/// The digest of a request to `key`, without its timeout.
pub fn digest(key: &str, request: &Request) -> Digest {
    let mut hasher = blake3::Hasher::new();
    hasher.update(key.as_bytes());
    for number in [request.at_step, request.expect_epoch, request.expect_step] {
        hasher.update(&[u8::from(number.is_some())]);
        hasher.update(&number.unwrap_or_default().to_le_bytes());
    }
    // By value, independent of spelling and of the order of fields.
    let args = request.args.as_ref().map_or("{}", |args| args.get());
    match serde_json::from_str(args) {
        Ok(args) => add(&mut hasher, &args),
        Err(_) => drop(hasher.update(args.as_bytes())),
    }
    *hasher.finalize().as_bytes()
}

/// Adds a value to a digest; different values add different bytes.
fn add(hasher: &mut blake3::Hasher, value: &Value) {
    match value {
        Value::Null => drop(hasher.update(b"n")),
        Value::Bool(is_true) => drop(hasher.update(if *is_true { b"t" } else { b"f" })),
        Value::Number(number) => {
            // 1 and 1.0 are equal; numbers that no double represents differ in their text.
            let double = number.as_f64().unwrap_or(f64::NAN);
            let text = match number.as_f64() {
                Some(double) if double.fract() == 0.0 && double.abs() < EXACT => String::new(),
                _ => number.to_string(),
            };
            hasher.update(b"d").update(&double.to_le_bytes());
            add_text(hasher, &text);
        }
        Value::String(text) => {
            hasher.update(b"s");
            add_text(hasher, text);
        }
        Value::Array(values) => {
            hasher.update(b"l").update(&values.len().to_le_bytes());
            values.iter().for_each(|value| add(hasher, value));
        }
        Value::Object(fields) => {
            hasher.update(b"o").update(&fields.len().to_le_bytes());
            let fields: BTreeMap<_, _> = fields.iter().collect();
            for (name, value) in fields {
                add_text(hasher, name);
                add(hasher, value);
            }
        }
    }
}

fn add_text(hasher: &mut blake3::Hasher, text: &str) {
    hasher
        .update(&text.len().to_le_bytes())
        .update(text.as_bytes());
}

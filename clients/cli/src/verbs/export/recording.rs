//! The frames of a recording.

use std::path::Path;

use jostle_experiment::html::{EncodedFrames, FrameEncoder, FrameOfBodies};
use jostle_physics::model::CELL;
use jostle_proto::{Event, EventKind, State};
use jostle_results::recording::{self, About, RecordingError};
use serde_json::Value;

use crate::failure::Failure;

/// The most bytes of frames before compression: a browser unpacks them at once.
const MAX_BYTES: usize = 100_000_000;

/// Reads a recording; returns the name of its swarm and its frames.
pub fn frames(path: &Path) -> Result<(String, EncodedFrames), Failure> {
    let wrong = |problem: String| Failure::argument(path.display(), problem);
    // These errors name the file.
    let unread = |error: RecordingError| Failure::new("invalid_argument", error.to_string());
    let about = recording::metadata(path).map_err(unread)?;
    let dt = number(&about, "spec", "dt").map_err(wrong)?;
    let at_start = number(&about, "spec", "pi1").map_err(wrong)?;
    let mut pi1 = number(&about, "parameters", "pi1").map_err(wrong)?;
    let mut encoder = FrameEncoder::new(dt);
    let mut count = 0_u64;
    let read = recording::read(path, |message| {
        match message.topic {
            "state" => {
                count += 1;
                let state = State::from_cbor(message.bytes);
                let added = state.and_then(|state| add(&mut encoder, &state, pi1));
                added.map_err(|problem| format!("frame {count}: {problem}"))?;
            }
            "event" => {
                let event: Event = serde_json::from_slice(message.bytes)
                    .map_err(|error| format!("an event after frame {count}: {error}"))?;
                if let EventKind::Command { verb, args, .. } = event.event {
                    pi1 = match verb.as_str() {
                        "reset" => at_start,
                        verb => set_in(verb, &args).unwrap_or(pi1),
                    };
                }
            }
            _ => {}
        }
        match encoder.bytes() > MAX_BYTES {
            true => Err(format!(
                "its frames have more than {} MB: record with a larger --every",
                MAX_BYTES / 1_000_000
            )),
            false => Ok(()),
        }
    });
    read.map_err(unread)?;
    if count == 0 {
        return Err(wrong("it has no frame".to_owned()));
    }
    let name = about.get("swarm").cloned().unwrap_or_default();
    Ok((name, encoder.finish()))
}

/// A number in the metadata.
fn number(about: &About, key: &str, field: &str) -> Result<f64, String> {
    let text = about.get(key).map_or("null", String::as_str);
    let value: Value = serde_json::from_str(text).unwrap_or_default();
    value[field].as_f64().ok_or_else(|| {
        format!("it has no {field} in the {key} of its metadata: jostle did not record it")
    })
}

/// The value of `pi1` that a command sets, if it does.
fn set_in(verb: &str, args: &Value) -> Option<f64> {
    match verb {
        "set" => args["pi1"].as_f64(),
        _ => {
            let changes = args["commands"].as_array()?.iter().rev();
            let mut set = changes.filter(|it| it["verb"] == "set");
            set.find_map(|it| it["args"]["pi1"].as_f64())
        }
    }
}

fn add(encoder: &mut FrameEncoder, state: &State, pi1: f64) -> Result<(), String> {
    let n = state.id.len();
    if [&state.x, &state.y, &state.alpha, &state.weight]
        .iter()
        .any(|column| column.len() != n)
    {
        return Err("its columns are not of one length".to_owned());
    }
    let [x, y] = state.origin.map(|origin| CELL * origin as f64);
    let shifted = |column: &[f64], by: f64| column.iter().map(|it| it + by).collect::<Vec<_>>();
    let frame = FrameOfBodies {
        step: state.step,
        id: &state.id,
        x: &shifted(&state.x, x),
        y: &shifted(&state.y, y),
        alpha: &state.alpha,
        weight: &state.weight,
    };
    encoder.add(&frame, pi1);
    Ok(())
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn the_last_ratio_of_a_batch_is_in_effect() {
        let set = |pi1: f64| json!({"verb": "set", "args": {"pi1": pi1}});
        assert_eq!(set_in("set", &json!({"pi1": 3})), Some(3.0));
        assert_eq!(set_in("set", &json!({"pi3": 3})), None);
        assert_eq!(set_in("run", &json!({})), None);
        let batch = json!({"commands": [set(2.0), set(5.0), {"verb": "set", "args": {"pi3": 1}}]});
        assert_eq!(set_in("batch", &batch), Some(5.0));
        assert_eq!(set_in("fired", &batch), Some(5.0));
    }
}

//! `record --recover`: completes the file of a recording whose process was killed.

use std::path::Path;

use jostle_results::recording::{self, Recovered, Recovery};
use serde_json::json;

use super::fetch::check_fetched;
use super::{decode, explain};
use crate::failure::Failure;
use crate::format;
use crate::output::Output;

/// Recovers the recording to `file`, and prints its size.
pub fn recover(output: Output, file: &Path, force: bool) -> Result<(), Failure> {
    if !recording::partial(file).exists() {
        check_fetched(file)?;
    }
    let recovery = recording::recover(file, force, decode).map_err(|error| explain(file, error))?;
    match recovery {
        Recovery::Whole(path) => {
            let file = path.display().to_string();
            let text = format!("nothing to recover: {file} is whole");
            output.print(&json!({"file": file, "recovered": false}), &text)
        }
        Recovery::Recovered(recovered) => print(output, &recovered),
    }
}

fn print(output: Output, recovered: &Recovered) -> Result<(), Failure> {
    let Recovered {
        path,
        frames,
        first_step,
        last_step,
        bytes,
        damaged,
        unread,
    } = recovered;
    let file = path.display().to_string();
    let document = json!({
        "file": file, "recovered": true, "frames": frames, "first_step": first_step,
        "last_step": last_step, "bytes": bytes, "damaged": damaged, "unread_bytes": unread,
    });
    let mut text = format!(
        "recovered {} to {file}, from step {first_step} up to step {last_step}, {}",
        format::count(*frames, "state"),
        format::bytes(*bytes)
    );
    if *damaged > 0 {
        let places = format::count(*damaged, "damaged place");
        text.push_str(&format!("; skipped {places} and kept the partial file"));
    }
    if *unread > 0 {
        let bytes = format::bytes(*unread);
        text.push_str(&format!(
            "; skipped the last {bytes}, which hold no complete record"
        ));
    }
    output.print(&document, &text)
}

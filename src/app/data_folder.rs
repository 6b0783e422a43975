//! Checks of the data folder before it is opened.

use std::fs;
use std::path::Path;

use jostle_proto::keys;

use crate::app::error::ServerError;
use crate::store::{FILE, RESTORING, WAL};

/// Rejects a folder that has recordings or experiments but no database: the swarms are lost, and a
/// new database would hide that.
pub fn check(folder: &Path) -> Result<(), ServerError> {
    let is_filled =
        |name: &str| fs::read_dir(folder.join(name)).is_ok_and(|mut it| it.next().is_some());
    let has_rest = ["experiments", "recordings"].into_iter().any(is_filled) || has(folder, WAL);
    // The store reports an interrupted restoration.
    match has_rest && !has(folder, FILE) && !folder.join(RESTORING).exists() {
        true => Err(ServerError::NoDatabase(folder.display().to_string())),
        false => Ok(()),
    }
}

/// A warning if the folder of this node is new but other nodes have data beside it, as after a change
/// of the host name.
pub fn other_data(folder: &Path, node: &str) -> Option<String> {
    let parent = folder.parent()?;
    if !folder.ends_with(node) || has(folder, FILE) {
        return None;
    }
    let entries = fs::read_dir(parent).ok()?.filter_map(Result::ok);
    let nodes = entries.filter(|entry| has(&entry.path(), FILE));
    let nodes = nodes.filter_map(|entry| entry.file_name().into_string().ok());
    let mut nodes: Vec<String> = nodes.filter(|name| keys::is_name(name)).collect();
    nodes.sort();
    let first = nodes.first()?;
    Some(format!(
        "{} also has the data of node {}: if the name of this machine has changed, set `node` in the \
         settings to the earlier name, such as node = {first:?}, and restart the daemon",
        parent.display(),
        nodes.join(", ")
    ))
}

/// Whether the folder has a file of this name that is not empty.
pub fn has(folder: &Path, name: &str) -> bool {
    fs::metadata(folder.join(name)).is_ok_and(|file| file.len() > 0)
}

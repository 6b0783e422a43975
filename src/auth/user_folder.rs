//! The folder that is handed to a user: their credentials, for jostle and for other zenoh clients.

use std::path::{Path, PathBuf};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_proto::Credentials;
use serde_json::{Value, json};

use crate::auth::AuthError;
use crate::auth::certificates::Pair;
use crate::auth::folder::{Folder, PeopleFile, read, write, write_json};

/// The settings for zenoh clients other than jostle.
const ZENOH: &str = "zenoh.json5";

/// Writes the files of a new user.
pub(super) fn create(
    path: &Path,
    credentials: &Credentials,
    ca: &str,
    pair: &Pair,
) -> Result<(), AuthError> {
    let [ca_file, certificate, key] = Credentials::CERTIFICATES.map(|file| path.join(file));
    write(&ca_file, ca)?;
    write_pair(pair, [certificate, key])?;
    write_json(&path.join(Credentials::FILE), credentials)?;
    write_json(&path.join(ZENOH), &zenoh_settings(credentials, ca, pair))
}

/// Writes the addresses of the daemon into the folder of a user. Returns `false` if the folder has
/// been moved away.
pub(super) fn rewrite(folder: &Folder, name: &str, known: &PeopleFile) -> Result<bool, AuthError> {
    let path = folder.person_folder(name);
    let file = path.join(Credentials::FILE);
    if !file.exists() {
        return Ok(false);
    }
    let credentials = Credentials {
        endpoint: known.endpoint.clone(),
        page: known.page.clone(),
        ..folder.credentials(name)?
    };
    let [ca, certificate, key] = Credentials::CERTIFICATES.map(|file| read(&path.join(file)));
    let pair = Pair {
        certificate: certificate?,
        key: key?,
    };
    let settings = zenoh_settings(&credentials, &ca?, &pair);
    write_json(&path.join(ZENOH), &settings)?;
    write_json(&file, &credentials)?;
    Ok(true)
}

/// Writes a certificate and its key.
pub(super) fn write_pair(pair: &Pair, [certificate, key]: [PathBuf; 2]) -> Result<(), AuthError> {
    write(&key, &pair.key)?;
    write(&certificate, &pair.certificate)
}

/// A complete zenoh configuration in one file.
fn zenoh_settings(credentials: &Credentials, ca: &str, pair: &Pair) -> Value {
    json!({
        "mode": "client",
        "connect": {"endpoints": [credentials.endpoint]},
        "scouting": {"multicast": {"enabled": false}, "gossip": {"enabled": false}},
        "transport": {
            "auth": {"usrpwd": {"user": credentials.person, "password": credentials.password}},
            "link": {"tls": {
                "enable_mtls": true,
                "root_ca_certificate_base64": STANDARD.encode(ca),
                "connect_certificate_base64": STANDARD.encode(&pair.certificate),
                "connect_private_key_base64": STANDARD.encode(&pair.key),
            }},
        },
    })
}

//! The message of a daemon that does not start, with the remedy for its settings.

use std::fs;
use std::io::ErrorKind;
use std::os::unix::fs::MetadataExt as _;
use std::path::Path;

use crate::app::ServerError;
use crate::auth::AuthError;
use crate::config::{Config, Resolved};
use crate::store::StoreError;
use crate::transport::http::GatewayError;
use crate::transport::zenoh::session::SessionError;

/// The message for `error`; `user` is the one of this process.
pub fn message(
    error: &ServerError,
    config: &Config,
    resolved: &Resolved,
    is_demo: bool,
    user: u32,
) -> String {
    let remedy = match error {
        ServerError::Gateway(GatewayError::Listen { address, source }) => {
            let is_in_use = source.kind() == ErrorKind::AddrInUse;
            if is_demo && is_in_use {
                return beside(&address.to_string());
            }
            let free = match config.http.starts_with("https://") {
                true => "",
                false => ", `--http 127.0.0.1:0` selects a free port",
            };
            let set = setting(resolved, "http");
            format!("; {set}: set another address{free}, `--http ''` disables HTTP")
        }
        ServerError::Session(SessionError::Listen { endpoints, reason }) => {
            let is_in_use = reason.contains("in use");
            if is_demo && is_in_use {
                return beside(endpoints);
            }
            let user = match is_in_use {
                true => "\nanother daemon or a zenoh router, whose default port is 7447, uses it",
                false => "",
            };
            let free = match config.listen.iter().any(|it| it.starts_with("tls/")) {
                true => "",
                false => ", `--listen tcp/127.0.0.1:0` selects a free port",
            };
            let set = setting(resolved, "listen");
            format!("{user}; {set}: set another address{free}")
        }
        ServerError::Rights(AuthError::File { .. } | AuthError::Foreign(_)) => {
            let folder = config.auth_dir.as_deref();
            folder.map_or_else(String::new, |it| owner_remedy(it, &config.data_dir, user))
        }
        ServerError::Store(StoreError::Folder { .. } | StoreError::Io { .. })
        | ServerError::Folder { .. }
        | ServerError::Token(_) => owner_remedy(&config.data_dir, &config.data_dir, user),
        _ => String::new(),
    };
    format!("{error}{remedy}")
}

fn setting(resolved: &Resolved, name: &str) -> String {
    let (value, source) = &resolved[name];
    format!("the setting is {name} = {value:?} ({source})")
}

/// The message of a demo beside another daemon.
fn beside(address: &str) -> String {
    format!(
        "another jostled may already run here ({address} is in use): use it, or run the demo beside \
         it with `jostled demo --listen tcp/127.0.0.1:0 --http 127.0.0.1:0`"
    )
}

/// The command that gives `folder` to `user`, if it or a file in it belongs to another user. The
/// reference is the nearest folder above `data` that belongs to `user`.
fn owner_remedy(folder: &Path, data: &Path, user: u32) -> String {
    let is_own = |path: &Path| fs::metadata(path).is_ok_and(|it| it.uid() == user);
    let is_foreign = |path: &Path| fs::metadata(path).is_ok_and(|it| it.uid() != user);
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    if !is_foreign(folder) && !entries.map(|it| it.path()).any(|it| is_foreign(&it)) {
        return String::new();
    }
    let mut above = data.ancestors().skip(1);
    let owner = match above.find(|it| is_own(it)) {
        Some(reference) => format!("--reference={}", reference.display()),
        None => user.to_string(),
    };
    let folder = folder.display();
    format!(
        "; {folder} or a file in it belongs to another user than the daemon's: as root, `chown -R \
         {owner} {folder}`"
    )
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use std::io;

    use super::*;
    use crate::cli::settings::from_flags;

    #[test]
    fn a_folder_of_another_user_is_named_with_the_command_that_gives_it_away() {
        let base = tempfile::tempdir().unwrap();
        let [data, auth] = ["state/data", "auth"].map(|name| base.path().join(name));
        for folder in [&data, &auth] {
            fs::create_dir_all(folder).unwrap();
        }
        let own = fs::metadata(base.path()).unwrap().uid();
        let flags = [
            ("data_dir", data.to_str().unwrap()),
            ("auth_dir", auth.to_str().unwrap()),
        ];
        let resolved = from_flags(flags).unwrap();
        let config = Config::new(&resolved).unwrap();
        let denied = || io::Error::from(ErrorKind::PermissionDenied);
        let people = AuthError::File {
            path: auth.join("people.json"),
            error: denied(),
        };
        let database = StoreError::Io {
            file: data.join("jostle.sqlite"),
            detail: "unable to open database file".to_owned(),
        };
        for (error, folder) in [(people.into(), &auth), (database.into(), &data)] {
            let message = |user| message(&error, &config, &resolved, false, user);
            let folder = folder.display();
            let other = own + 1;
            assert!(
                message(other).ends_with(&format!(": as root, `chown -R {other} {folder}`")),
                "{}",
                message(other)
            );
            assert!(!message(own).contains("chown"), "{}", message(own));
        }
        // Only root can give a file away.
        let file = base.path().join("auth/people.json");
        fs::write(&file, "").unwrap();
        if std::os::unix::fs::chown(&file, Some(own + 1), None).is_ok() {
            let remedy = owner_remedy(&base.path().join("auth"), &data, own);
            let reference = format!("--reference={}", data.parent().unwrap().display());
            assert!(remedy.contains(&reference), "{remedy}");
        }
    }
}

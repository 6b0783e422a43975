//! What `jostled auth` does: an authority, and for each person a name, a role and secrets.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_proto::role::is_person;
use jostle_proto::{Credentials, Role};
use serde_json::{Value, json};

use crate::auth::address::{Address, Reach};
use crate::auth::certificates::{Authority, DAEMON, Pair, last_day};
use crate::auth::folder::{Entry, Folder, People, at, read, write, write_json};
use crate::auth::{RightsError, secret};

/// The settings for clients that speak nothing but zenoh, in a person's folder.
const ZENOH: &str = "zenoh.json5";

/// Bytes of a token, and of a password.
const SECRET_BYTES: usize = 32;

/// The result of a change of the daemon's addresses.
#[derive(Debug)]
pub struct Moved {
    /// Where the daemon is reached from its next start on.
    pub address: Address,
    /// The names of its certificate.
    pub names: Vec<String>,
    /// The people's folders that are here, if they say something else now; the secrets are the same.
    pub rewritten: Vec<PathBuf>,
    /// The people whose folders are not here and say something else.
    pub stale: Vec<String>,
}

/// Makes what is not there yet: the authority, the daemon's certificate for `hosts`, and people.
/// The daemon's certificate is made anew when hosts are named. Returns the folders for people.
///
/// # Errors
///
/// [`RightsError`]; nobody is added then.
pub fn init(
    folder: &Folder,
    hosts: &[String],
    people: &[(String, Role)],
) -> Result<Vec<PathBuf>, RightsError> {
    let reach = Reach {
        hosts: hosts.to_owned(),
        ..Reach::default()
    };
    Ok(set_up(folder, &reach, people)?.made)
}

/// What [`set_up`] changed.
#[derive(Debug)]
pub struct SetUp {
    /// The folders of the people that were added.
    pub made: Vec<PathBuf>,
    /// What `reach` changed in a folder that already existed.
    pub moved: Option<Moved>,
}

/// The same, for a daemon that is reached as `reach` says.
///
/// # Errors
///
/// [`RightsError`]; nobody is added then.
pub fn set_up(
    folder: &Folder,
    reach: &Reach,
    people: &[(String, Role)],
) -> Result<SetUp, RightsError> {
    check(people)?;
    // Refuses an address before anything is made.
    let known = folder.is_made()?.then(|| folder.people()).transpose()?;
    Address::of(folder, known.as_ref(), reach)?;
    let mut entries = known.iter().flat_map(|known| &known.people);
    let other_role = entries.find(|entry| {
        let mut people = people.iter();
        people.any(|(name, role)| *name == entry.person && *role != entry.role)
    });
    if let Some(entry) = other_role {
        return Err(RightsError::There(entry.person.clone()));
    }
    make_folder(folder.path())?;
    folder.check_own()?;
    let _held = folder.hold()?;
    let authority = authority(folder)?;
    let known = folder.is_made()?.then(|| folder.people()).transpose()?;
    // An interrupted run has not recorded when its certificate expires.
    let is_noted = known.as_ref().is_some_and(|known| known.until.is_some());
    let is_whole = is_noted && folder.daemon().iter().all(|path| path.exists());
    if known.is_none() {
        folder.write_passwords(&[])?;
    }
    let was_made = known.is_some();
    let (known, moved) = match is_whole && reach.is_empty() && folder.settings_file().exists() {
        true => (known.map_or_else(|| folder.people(), Ok)?, None),
        false => {
            let (known, moved) = relocate(&authority, folder, known, reach)?;
            (known, (was_made && !reach.is_empty()).then_some(moved))
        }
    };
    // Who is there already stays as they are.
    let is_there = |(name, role): &(String, Role)| {
        let mut entries = known.people.iter();
        entries.any(|it| it.person == *name && it.role == *role)
    };
    let new: Vec<_> = people.iter().filter(|it| !is_there(it)).cloned().collect();
    let made = add_by(&authority, folder, &new)?;
    Ok(SetUp { made, moved })
}

/// Changes where the daemon is reached, from its next start on: its certificate is issued again by
/// the same authority, and the folders of people that are here are rewritten.
///
/// # Errors
///
/// [`RightsError`]; nothing is changed then, unless a file cannot be written.
pub fn readdress(folder: &Folder, reach: &Reach) -> Result<Moved, RightsError> {
    folder.people()?;
    folder.check_own()?;
    let _held = folder.hold()?;
    let known = folder.people()?;
    Address::of(folder, Some(&known), reach)?;
    let [_, key] = folder.authority();
    if !key.exists() {
        return Err(RightsError::NoAuthority(key));
    }
    Ok(relocate(&authority(folder)?, folder, Some(known), reach)?.1)
}

/// Issues the daemon's certificate, and writes where it is reached.
fn relocate(
    authority: &Authority,
    folder: &Folder,
    known: Option<People>,
    reach: &Reach,
) -> Result<(People, Moved), RightsError> {
    let address = Address::of(folder, known.as_ref(), reach)?;
    let names = address.names();
    keep(&authority.certify_daemon(&names)?, folder.daemon())?;
    address.write_settings(folder, reach)?;
    let is_moved = known
        .as_ref()
        .is_some_and(|known| (&known.endpoint, &known.page) != (&address.endpoint, &address.page));
    let known = People {
        endpoint: address.endpoint.clone(),
        page: address.page.clone(),
        hosts: Some(address.hosts.clone()),
        until: Some(last_day()),
        people: known.map(|known| known.people).unwrap_or_default(),
    };
    let (rewritten, stale) = match is_moved {
        // `people.json` comes last: an interrupted run is repeated as long as it is the old one.
        true => {
            let rewritten = rewrite(folder, &known)?;
            let names = known.people.iter().map(|entry| entry.person.clone());
            let is_stale = |name: &String| !rewritten.contains(&folder.of(name));
            let stale = names.filter(is_stale).collect();
            (rewritten, stale)
        }
        false => Default::default(),
    };
    folder.write_people(&known)?;
    let moved = Moved {
        address,
        names,
        stale,
        rewritten,
    };
    Ok((known, moved))
}

/// Writes where the daemon is reached into the folders of people that are here. Returns those.
fn rewrite(folder: &Folder, known: &People) -> Result<Vec<PathBuf>, RightsError> {
    let mut rewritten = Vec::new();
    for entry in &known.people {
        let path = folder.of(&entry.person);
        let file = path.join(Credentials::FILE);
        if !file.exists() {
            continue;
        }
        let credentials = Credentials {
            endpoint: known.endpoint.clone(),
            page: known.page.clone(),
            ..folder.credentials(&entry.person)?
        };
        let [ca, certificate, key] = Credentials::CERTIFICATES.map(|file| read(&path.join(file)));
        let pair = Pair {
            certificate: certificate?,
            key: key?,
        };
        let settings = zenoh_settings(&credentials, &ca?, &pair);
        write_json(&path.join(ZENOH), &settings)?;
        write_json(&file, &credentials)?;
        rewritten.push(path);
    }
    Ok(rewritten)
}

/// Adds people, and returns the folders to hand to them.
///
/// # Errors
///
/// [`RightsError`]; nobody is added then.
pub fn add(folder: &Folder, people: &[(String, Role)]) -> Result<Vec<PathBuf>, RightsError> {
    check(people)?;
    folder.people()?;
    folder.check_own()?;
    let _held = folder.hold()?;
    let [_, key] = folder.authority();
    match key.exists() {
        true => add_by(&authority(folder)?, folder, people),
        false => Err(RightsError::NoAuthority(key)),
    }
}

/// The folder's authority. Of one whose making was cut off the key is there, and the certificate
/// is made again.
fn authority(folder: &Folder) -> Result<Authority, RightsError> {
    let [certificate, key] = folder.authority();
    if !key.exists() && certificate.exists() {
        return Err(RightsError::NoAuthority(key));
    }
    if !key.exists() {
        write(&key, &Authority::draw()?)?;
    }
    let authority = Authority::of_key(&read(&key)?)?;
    if !certificate.exists() {
        write(&certificate, &authority.certificate()?)?;
    }
    Ok(authority)
}

/// Takes people's rights away: a running daemon rejects their tokens within seconds.
///
/// # Errors
///
/// [`RightsError`]; nobody is removed then.
pub fn remove(folder: &Folder, names: &[String]) -> Result<(), RightsError> {
    folder.people()?;
    folder.check_own()?;
    let _held = folder.hold()?;
    let (mut known, mut passwords) = (folder.people()?, folder.passwords()?);
    for name in names {
        let is_known = known.people.iter().any(|entry| entry.person == *name);
        // What is left of somebody whose removal was cut off is taken away, too.
        let has_password = passwords.iter().any(|(person, _)| person == name);
        let is_left = is_person(name) && (has_password || folder.of(name).exists());
        if !is_known && !is_left {
            return Err(RightsError::Nobody(name.clone()));
        }
    }
    known.people.retain(|entry| !names.contains(&entry.person));
    sweep(folder, &known, &mut passwords)?;
    // Their rights go first: a password alone opens nothing.
    folder.write_people(&known)?;
    folder.write_passwords(&passwords)?;
    Ok(())
}

/// Takes away what is left of people who are nobody, since adding or removing them was cut off:
/// their folders at once, their passwords from `passwords`.
fn sweep(
    folder: &Folder,
    known: &People,
    passwords: &mut Vec<(String, String)>,
) -> Result<(), RightsError> {
    let is_known = |name: &str| known.people.iter().any(|entry| entry.person == name);
    passwords.retain(|(person, _)| is_known(person));
    for name in folder.handed()? {
        if is_person(&name) && !is_known(&name) {
            let path = folder.of(&name);
            fs::remove_dir_all(&path).map_err(|error| at(&path, error))?;
        }
    }
    Ok(())
}

fn check(people: &[(String, Role)]) -> Result<(), RightsError> {
    let is_taken = |name: &str| !is_person(name) || name == DAEMON;
    if let Some((name, _)) = people.iter().find(|(name, _)| is_taken(name)) {
        return Err(RightsError::Name(name.clone()));
    }
    let mut seen = BTreeSet::new();
    match people.iter().find(|(name, _)| !seen.insert(name)) {
        Some((name, _)) => Err(RightsError::Twice(name.clone())),
        None => Ok(()),
    }
}

fn add_by(
    authority: &Authority,
    folder: &Folder,
    people: &[(String, Role)],
) -> Result<Vec<PathBuf>, RightsError> {
    let (mut known, mut passwords) = (folder.people()?, folder.passwords()?);
    sweep(folder, &known, &mut passwords)?;
    let mut made = Vec::new();
    for (name, role) in people {
        if known.people.iter().any(|entry| entry.person == *name) {
            return Err(RightsError::There(name.clone()));
        }
        let draw = || secret::draw(SECRET_BYTES).map_err(|error| at(folder.path(), error));
        let credentials = Credentials {
            person: name.clone(),
            role: *role,
            endpoint: known.endpoint.clone(),
            page: known.page.clone(),
            token: draw()?,
            password: draw()?,
        };
        known.people.push(Entry {
            person: name.clone(),
            role: *role,
            token_hash: blake3::hash(credentials.token.as_bytes()).to_string(),
            until: Some(last_day()),
        });
        passwords.push((name.clone(), credentials.password.clone()));
        made.push(credentials);
    }
    let [certificate, _] = folder.authority();
    let trusted = read(&certificate)?;
    let mut folders = Vec::new();
    for credentials in &made {
        let path = folder.of(&credentials.person);
        make_folder(&path)?;
        let [ca, certificate, key] = Credentials::CERTIFICATES.map(|file| path.join(file));
        write(&ca, &trusted)?;
        let pair = authority.certify_person(&credentials.person)?;
        keep(&pair, [certificate, key])?;
        write_json(&path.join(Credentials::FILE), credentials)?;
        write_json(
            &path.join(ZENOH),
            &zenoh_settings(credentials, &trusted, &pair),
        )?;
        folders.push(path);
    }
    // What lets them in comes last.
    known.people.sort_by(|a, b| a.person.cmp(&b.person));
    passwords.sort();
    folder.write_passwords(&passwords)?;
    folder.write_people(&known)?;
    Ok(folders)
}

/// What a client that is no jostle's opens zenoh with, all in one file.
fn zenoh_settings(credentials: &Credentials, trusted: &str, pair: &Pair) -> Value {
    let Credentials {
        person,
        endpoint,
        password,
        ..
    } = credentials;
    json!({
        "mode": "client",
        "connect": {"endpoints": [endpoint]},
        "scouting": {"multicast": {"enabled": false}, "gossip": {"enabled": false}},
        "transport": {
            "auth": {"usrpwd": {"user": person, "password": password}},
            "link": {"tls": {
                "enable_mtls": true,
                "root_ca_certificate_base64": STANDARD.encode(trusted),
                "connect_certificate_base64": STANDARD.encode(&pair.certificate),
                "connect_private_key_base64": STANDARD.encode(&pair.key),
            }},
        },
    })
}

fn make_folder(path: &Path) -> Result<(), RightsError> {
    secret::make_folder(path).map_err(|error| at(path, error))
}

fn keep(pair: &Pair, [certificate, key]: [PathBuf; 2]) -> Result<(), RightsError> {
    write(&key, &pair.key)?;
    write(&certificate, &pair.certificate)
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use std::os::unix::fs::PermissionsExt;

    use super::*;
    use crate::auth::Rights;

    fn person(name: &str) -> (String, Role) {
        (name.to_owned(), Role::Viewer)
    }

    #[test]
    fn what_is_there_stays_and_what_is_not_is_made_for_nobody_else_to_read() {
        let base = tempfile::tempdir().unwrap();
        let folder = Folder::at(base.path().join("deep/auth"));
        assert!(matches!(
            Rights::read(folder.clone()),
            Err(RightsError::Nothing(_))
        ));
        init(&folder, &[], &[person("anna")]).unwrap();
        let [ca, key] = folder.authority();
        let before = (read(&ca).unwrap(), folder.credentials("anna").unwrap());
        init(&folder, &["lab.example".into()], &[person("ben")]).unwrap();
        add(&folder, &[person("cleo")]).unwrap();
        let after = folder.credentials("anna").unwrap();
        assert_eq!(read(&ca).unwrap(), before.0);
        assert!((&after.token, &after.password) == (&before.1.token, &before.1.password));
        assert_eq!(after.endpoint, "tls/lab.example:7447");
        let names: Vec<_> = folder
            .people()
            .unwrap()
            .people
            .into_iter()
            .map(|it| it.person)
            .collect();
        assert_eq!(names, ["anna", "ben", "cleo"]);
        assert_eq!(folder.passwords().unwrap().len(), 3);

        let mut folders = vec![folder.path().to_owned()];
        while let Some(path) = folders.pop() {
            let mode = fs::metadata(&path).unwrap().permissions().mode();
            assert_eq!(mode & 0o077, 0, "{}", path.display());
            if path.is_dir() {
                let entries = fs::read_dir(&path).unwrap();
                folders.extend(entries.map(|entry| entry.unwrap().path()));
            }
        }
        let set = |path: &Path, mode| {
            fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
        };
        Rights::read(folder.clone()).unwrap();
        for path in [key, folder.passwords_file()] {
            set(&path, 0o640);
            let refused = Rights::read(folder.clone());
            assert!(matches!(refused, Err(RightsError::Open(_))));
            set(&path, 0o600);
        }
        for (path, mode) in [(folder.path(), 0o700), (&folder.people_file(), 0o600)] {
            set(path, 0o777);
            let refused = Rights::read(folder.clone());
            assert!(matches!(refused, Err(RightsError::Changeable(_))));
            set(path, mode);
        }
        Rights::read(folder).unwrap();
    }

    #[test]
    fn what_root_writes_belongs_to_whom_the_folder_belongs() {
        use std::os::unix::fs::{MetadataExt, chown};
        if !rustix::process::geteuid().is_root() {
            return;
        }
        let base = tempfile::tempdir().unwrap();
        let folder = Folder::at(base.path().join("auth"));
        init(&folder, &[], &[person("anna")]).unwrap();
        let files = [
            folder.path().to_owned(),
            folder.people_file(),
            folder.passwords_file(),
        ];
        for path in &files {
            chown(path, Some(12345), Some(12346)).unwrap();
        }
        add(&folder, &[person("ben")]).unwrap();
        remove(&folder, &["anna".into()]).unwrap();
        for path in &files {
            let owner = fs::metadata(path).unwrap();
            assert_eq!(
                (owner.uid(), owner.gid()),
                (12345, 12346),
                "{}",
                path.display()
            );
        }
    }

    #[test]
    fn what_was_cut_off_is_made_whole() {
        let base = tempfile::tempdir().unwrap();
        let folder = Folder::at(base.path().join("auth"));
        init(&folder, &[], &[person("anna")]).unwrap();
        let [[ca, _], [daemon, daemon_key]] = [folder.authority(), folder.daemon()];
        for lost in [&ca, &daemon, &daemon_key] {
            fs::remove_file(lost).unwrap();
            init(&folder, &[], &[]).unwrap();
            assert!(lost.exists());
        }
        fs::remove_file(&folder.authority()[1]).unwrap();
        let refused = add(&folder, &[person("ben")]);
        assert!(matches!(refused, Err(RightsError::NoAuthority(_))));
        assert_eq!(folder.people().unwrap().people.len(), 1);
    }

    #[test]
    fn who_is_added_and_removed_at_once_is_there_and_is_not() {
        let base = tempfile::tempdir().unwrap();
        let folder = Folder::at(base.path().join("auth"));
        init(&folder, &[], &[person("evil")]).unwrap();
        std::thread::scope(|scope| {
            scope.spawn(|| remove(&folder, &["evil".into()]).unwrap());
            for name in ["a", "b", "c", "d"] {
                let folder = &folder;
                scope.spawn(move || add(folder, &[person(name)]).unwrap());
            }
        });
        let known = folder.people().unwrap().people;
        let names: Vec<_> = known.iter().map(|it| it.person.as_str()).collect();
        assert_eq!(names, ["a", "b", "c", "d"]);
        let passwords = folder.passwords().unwrap();
        let names: Vec<_> = passwords.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["a", "b", "c", "d"]);
    }

    #[test]
    fn what_is_left_of_people_who_are_nobody_goes_with_the_next_change() {
        let base = tempfile::tempdir().unwrap();
        let folder = Folder::at(base.path().join("auth"));
        init(&folder, &[], &[person("anna")]).unwrap();
        type Change = fn(&Folder);
        let changes: [Change; 3] = [
            |folder| drop(init(folder, &[], &[person("anna")]).unwrap()),
            |folder| drop(add(folder, &[person("ben")]).unwrap()),
            |folder| remove(folder, &["ben".into()]).unwrap(),
        ];
        for change in changes {
            let known = folder.people().unwrap();
            add(&folder, &[person("ghost")]).unwrap();
            // As a removal leaves it that is cut off at once.
            folder.write_people(&known).unwrap();
            let notices = Rights::read(folder.clone()).unwrap().notices(60).unwrap();
            assert!(
                notices[0].contains("`jostled auth remove ghost`"),
                "{notices:?}"
            );
            change(&folder);
            assert!(!folder.of("ghost").exists() && folder.of("anna").exists());
            let passwords = folder.passwords().unwrap();
            assert!(passwords.iter().all(|(name, _)| name != "ghost"));
        }
        // One whose making was cut off before it was noted until when it holds.
        let mut known = folder.people().unwrap();
        known.until = None;
        folder.write_people(&known).unwrap();
        init(&folder, &[], &[]).unwrap();
        assert_eq!(folder.people().unwrap().until, Some(last_day()));
        let other = (String::from("anna"), Role::Operator);
        assert!(matches!(
            init(&folder, &[], &[other]),
            Err(RightsError::There(_))
        ));
        assert!(matches!(
            add(&folder, &[person(DAEMON)]),
            Err(RightsError::Name(_))
        ));
    }

    #[test]
    fn a_refusal_changes_nothing() {
        let base = tempfile::tempdir().unwrap();
        let folder = Folder::at(base.path().join("auth"));
        assert!(matches!(
            add(&folder, &[person("anna")]),
            Err(RightsError::Nothing(_))
        ));
        assert!(matches!(
            init(&folder, &[], &[person("anna"), person("anna")]),
            Err(RightsError::Twice(_))
        ));
        assert!(!folder.path().exists());
        init(&folder, &[], &[person("anna")]).unwrap();
        let people = folder.people().unwrap();
        let operator = (String::from("anna"), Role::Operator);
        for refused in [
            init(&folder, &["lab.example".into()], &[operator]),
            add(&folder, &[person("ben"), person("anna")]),
            add(&folder, &[person("ben"), person("ben")]),
            add(&folder, &[person("ben"), person("ben-1")]),
            remove(&folder, &["anna".into(), "ben".into()]).map(|()| Vec::new()),
        ] {
            let refused = refused.unwrap_err().to_string();
            assert!(
                refused.contains("anna") || refused.contains("ben"),
                "{refused}"
            );
            assert_eq!(folder.people().unwrap(), people);
            assert!(!folder.of("ben").exists() && folder.of("anna").exists());
        }
        remove(&folder, &["anna".into()]).unwrap();
        assert!(
            folder.people().unwrap().people.is_empty() && folder.passwords().unwrap().is_empty()
        );
        assert!(!folder.of("anna").exists());
        for strange in [
            "no such host",
            "",
            "lab..example",
            "tls/lab:7447",
            "[::1]",
            "10.0.0.300",
        ] {
            let refused = init(&folder, &[strange.into()], &[]);
            assert!(matches!(refused, Err(RightsError::Host(_))), "{strange}");
        }
        init(
            &folder,
            &["10.0.0.1".into(), "fe80::1".into(), "lab-1.example".into()],
            &[],
        )
        .unwrap();
    }
}

//! The operations of `jostled auth`: create the authority, add, remove and readdress users.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::path::{Path, PathBuf};

use jostle_proto::role::is_person;
use jostle_proto::{Credentials, Role};

use crate::auth::address::{Address, AddressChange};
use crate::auth::certificates::{Authority, DAEMON, DAYS, in_days};
use crate::auth::folder::{Folder, PeopleFile, UserEntry, file_error, read, write};
use crate::auth::{AuthError, secret, user_folder};

/// Bytes of a token, and of a password.
const SECRET_BYTES: usize = 32;

/// The result of a change of the daemon's addresses.
#[derive(Debug)]
pub struct ChangedAddresses {
    /// The addresses of the daemon from its next start on.
    pub address: Address,
    /// The names of its certificate.
    pub names: Vec<String>,
    /// The folders of users that were changed; the secrets are the same.
    pub rewritten: Vec<PathBuf>,
    /// The users whose folders have been moved away and are outdated.
    pub stale: Vec<String>,
}

/// What [`set_up`] changed.
#[derive(Debug)]
pub struct SetUp {
    /// The folders of the users that were added.
    pub created: Vec<PathBuf>,
    /// What `reach` changed in a folder that already existed.
    pub moved: Option<ChangedAddresses>,
}

/// Creates what does not exist: the authority, the daemon's certificate and the users. If `hosts`
/// is not empty, issues the certificate again. Returns the folders of the new users.
pub fn init(
    folder: &Folder,
    hosts: &[String],
    users: &[(String, Role)],
) -> Result<Vec<PathBuf>, AuthError> {
    let address_change = AddressChange {
        hosts: hosts.to_owned(),
        ..AddressChange::default()
    };
    Ok(set_up(folder, &address_change, users)?.created)
}

/// As [`init`], for a daemon with the addresses `reach`. After an error no user is added.
pub fn set_up(
    folder: &Folder,
    address_change: &AddressChange,
    users: &[(String, Role)],
) -> Result<SetUp, AuthError> {
    check(users)?;
    // Rejects an invalid address before anything is created.
    let known = folder.exists()?.then(|| folder.people()).transpose()?;
    Address::of(folder, known.as_ref(), address_change)?;
    let mut entries = known.iter().flat_map(|known| &known.people);
    let other_role = entries.find(|entry| {
        let mut users = users.iter();
        users.any(|(name, role)| *name == entry.person && *role != entry.role)
    });
    if let Some(entry) = other_role {
        return Err(AuthError::Exists(entry.person.clone()));
    }
    make_folder(folder.path())?;
    folder.check_own()?;
    let _locked = folder.lock()?;
    let authority = authority(folder)?;
    let known = folder.exists()?.then(|| folder.people()).transpose()?;
    // An interrupted run has not recorded when its certificate expires.
    let is_recorded = known.as_ref().is_some_and(|known| known.until.is_some());
    let is_complete = is_recorded && folder.daemon().iter().all(|path| path.exists());
    if known.is_none() {
        folder.write_passwords(&[])?;
    }
    let existed = known.is_some();
    let (known, moved) =
        match is_complete && address_change.is_empty() && folder.settings_file().exists() {
            true => (known.map_or_else(|| folder.people(), Ok)?, None),
            false => {
                let (known, moved) = relocate(&authority, folder, known, address_change)?;
                (
                    known,
                    (existed && !address_change.is_empty()).then_some(moved),
                )
            }
        };
    let exists = |(name, role): &(String, Role)| {
        let mut entries = known.people.iter();
        entries.any(|it| it.person == *name && it.role == *role)
    };
    let new: Vec<_> = users.iter().filter(|it| !exists(it)).cloned().collect();
    let created = add_by(&authority, folder, &new)?;
    Ok(SetUp { created, moved })
}

/// Changes the addresses of the daemon from its next start on: issues its certificate again, and
/// rewrites the folders of users. After an error nothing has changed, unless a file cannot be
/// written.
pub fn readdress(
    folder: &Folder,
    address_change: &AddressChange,
) -> Result<ChangedAddresses, AuthError> {
    let (_locked, known) = lock(folder)?;
    Address::of(folder, Some(&known), address_change)?;
    let authority = existing_authority(folder)?;
    Ok(relocate(&authority, folder, Some(known), address_change)?.1)
}

/// Issues the daemon's certificate, and writes its addresses.
fn relocate(
    authority: &Authority,
    folder: &Folder,
    known: Option<PeopleFile>,
    address_change: &AddressChange,
) -> Result<(PeopleFile, ChangedAddresses), AuthError> {
    let address = Address::of(folder, known.as_ref(), address_change)?;
    let names = address.names();
    let pair = authority.certify_daemon(&names)?;
    user_folder::write_pair(&pair, folder.daemon())?;
    address.write_settings(folder, address_change)?;
    let is_moved = known
        .as_ref()
        .is_some_and(|known| (&known.endpoint, &known.page) != (&address.endpoint, &address.page));
    let known = PeopleFile {
        endpoint: address.endpoint.clone(),
        page: address.page.clone(),
        hosts: Some(address.hosts.clone()),
        until: Some(in_days(DAYS)),
        people: known.map(|known| known.people).unwrap_or_default(),
    };
    let (mut rewritten, mut stale) = (Vec::new(), Vec::new());
    // `people.json` comes last: while it is the old one, an interrupted run is repeated.
    let people = known.people.iter().filter(|_| is_moved);
    for UserEntry { person: name, .. } in people {
        match user_folder::rewrite(folder, name, &known)? {
            true => rewritten.push(folder.person_folder(name)),
            false => stale.push(name.clone()),
        }
    }
    folder.write_people(&known)?;
    let moved = ChangedAddresses {
        address,
        names,
        rewritten,
        stale,
    };
    Ok((known, moved))
}

/// Adds users, and returns the folders to hand to them. After an error no user is added.
pub fn add(folder: &Folder, users: &[(String, Role)]) -> Result<Vec<PathBuf>, AuthError> {
    check(users)?;
    let (_locked, _) = lock(folder)?;
    add_by(&existing_authority(folder)?, folder, users)
}

/// Removes users: a running daemon rejects their tokens within seconds. After an error no user is
/// removed.
pub fn remove(folder: &Folder, names: &[String]) -> Result<(), AuthError> {
    let (_locked, mut known) = lock(folder)?;
    let mut passwords = folder.passwords()?;
    for name in names {
        let is_known = known.people.iter().any(|entry| entry.person == *name);
        // An interrupted removal leaves a password or a folder.
        let has_password = passwords.iter().any(|(user, _)| user == name);
        let is_left = is_person(name) && (has_password || folder.person_folder(name).exists());
        if !is_known && !is_left {
            return Err(AuthError::Unknown(name.clone()));
        }
    }
    known.people.retain(|entry| !names.contains(&entry.person));
    sweep(folder, &known, &mut passwords)?;
    // The rights first: a password without a user permits no request.
    folder.write_people(&known)?;
    folder.write_passwords(&passwords)
}

/// Locks a folder that exists, and reads its users.
fn lock(folder: &Folder) -> Result<(File, PeopleFile), AuthError> {
    folder.people()?;
    folder.check_own()?;
    let locked = folder.lock()?;
    Ok((locked, folder.people()?))
}

/// The authority of the folder, which is created or completed.
fn authority(folder: &Folder) -> Result<Authority, AuthError> {
    let [certificate, key] = folder.authority();
    if !key.exists() && certificate.exists() {
        return Err(AuthError::NoAuthority(key));
    }
    if !key.exists() {
        write(&key, &Authority::generate_key()?)?;
    }
    let authority = Authority::of_key(&read(&key)?)?;
    if !certificate.exists() {
        write(&certificate, &authority.certificate()?)?;
    }
    Ok(authority)
}

fn existing_authority(folder: &Folder) -> Result<Authority, AuthError> {
    let [_, key] = folder.authority();
    match key.exists() {
        true => authority(folder),
        false => Err(AuthError::NoAuthority(key)),
    }
}

/// Removes what an interrupted run has left of users that do not exist: their folders, and their
/// passwords from `passwords`.
fn sweep(
    folder: &Folder,
    known: &PeopleFile,
    passwords: &mut Vec<(String, String)>,
) -> Result<(), AuthError> {
    let is_known = |name: &str| known.people.iter().any(|entry| entry.person == name);
    passwords.retain(|(user, _)| is_known(user));
    for name in folder.user_folders()? {
        if is_person(&name) && !is_known(&name) {
            let path = folder.person_folder(&name);
            fs::remove_dir_all(&path).map_err(|error| file_error(&path, error))?;
        }
    }
    Ok(())
}

fn check(users: &[(String, Role)]) -> Result<(), AuthError> {
    let is_invalid = |name: &str| !is_person(name) || name == DAEMON;
    if let Some((name, _)) = users.iter().find(|(name, _)| is_invalid(name)) {
        return Err(AuthError::Name(name.clone()));
    }
    let mut seen = BTreeSet::new();
    match users.iter().find(|(name, _)| !seen.insert(name)) {
        Some((name, _)) => Err(AuthError::Duplicate(name.clone())),
        None => Ok(()),
    }
}

fn add_by(
    authority: &Authority,
    folder: &Folder,
    users: &[(String, Role)],
) -> Result<Vec<PathBuf>, AuthError> {
    let (mut known, mut passwords) = (folder.people()?, folder.passwords()?);
    sweep(folder, &known, &mut passwords)?;
    let mut created = Vec::new();
    for (name, role) in users {
        if known.people.iter().any(|entry| entry.person == *name) {
            return Err(AuthError::Exists(name.clone()));
        }
        let draw =
            || secret::random_hex(SECRET_BYTES).map_err(|error| file_error(folder.path(), error));
        let credentials = Credentials {
            person: name.clone(),
            role: *role,
            endpoint: known.endpoint.clone(),
            page: known.page.clone(),
            token: draw()?,
            password: draw()?,
        };
        known.people.push(UserEntry {
            person: name.clone(),
            role: *role,
            token_hash: blake3::hash(credentials.token.as_bytes()).to_string(),
            until: Some(in_days(DAYS)),
        });
        passwords.push((name.clone(), credentials.password.clone()));
        created.push(credentials);
    }
    let [certificate, _] = folder.authority();
    let ca = read(&certificate)?;
    let mut folders = Vec::new();
    for credentials in &created {
        let path = folder.person_folder(&credentials.person);
        make_folder(&path)?;
        let pair = authority.certify_person(&credentials.person)?;
        user_folder::create(&path, credentials, &ca, &pair)?;
        folders.push(path);
    }
    // The password and the token hash come last.
    known.people.sort_by(|a, b| a.person.cmp(&b.person));
    passwords.sort();
    folder.write_passwords(&passwords)?;
    folder.write_people(&known)?;
    Ok(folders)
}

fn make_folder(path: &Path) -> Result<(), AuthError> {
    secret::make_folder(path).map_err(|error| file_error(path, error))
}

#[cfg(test)]
mod tests;

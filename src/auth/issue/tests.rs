#![expect(clippy::unwrap_used, reason = "tests")]

use std::os::unix::fs::PermissionsExt;

use super::*;
use crate::auth::Rights;
use crate::auth::tests::new_folder;

/// The name of each user in `people.json` and in the file of passwords.
fn names(folder: &Folder) -> Vec<[String; 2]> {
    let (people, passwords) = (folder.people().unwrap().people, folder.passwords().unwrap());
    assert_eq!(people.len(), passwords.len());
    let both = people.into_iter().zip(passwords);
    both.map(|(entry, (name, _))| [entry.person, name])
        .collect()
}

fn viewer(name: &str) -> (String, Role) {
    (name.to_owned(), Role::Viewer)
}

#[test]
fn init_keeps_what_exists_and_creates_the_rest_for_the_owner_only() {
    let base = tempfile::tempdir().unwrap();
    let folder = Folder::new(base.path().join("deep/auth"));
    let rejected = Rights::read(folder.clone());
    assert!(matches!(rejected, Err(AuthError::NoUsers(_))));
    init(&folder, &[], &[viewer("anna")]).unwrap();
    let [ca, key] = folder.authority();
    let before = (read(&ca).unwrap(), folder.credentials("anna").unwrap());
    init(&folder, &["lab.example".into()], &[viewer("ben")]).unwrap();
    add(&folder, &[viewer("cleo")]).unwrap();
    let after = folder.credentials("anna").unwrap();
    assert_eq!(read(&ca).unwrap(), before.0);
    assert!((&after.token, &after.password) == (&before.1.token, &before.1.password));
    assert_eq!(after.endpoint, "tls/lab.example:7447");
    assert_eq!(names(&folder), ["anna", "ben", "cleo"].map(|it| [it; 2]));

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
        let rejected = Rights::read(folder.clone());
        assert!(matches!(rejected, Err(AuthError::Readable(_))));
        set(&path, 0o600);
    }
    for (path, mode) in [(folder.path(), 0o700), (&folder.people_file(), 0o600)] {
        set(path, 0o777);
        let rejected = Rights::read(folder.clone());
        assert!(matches!(rejected, Err(AuthError::Writable(_))));
        set(path, mode);
    }
    Rights::read(folder).unwrap();
}

#[test]
fn files_that_root_writes_belong_to_the_owner_of_the_folder() {
    use std::os::unix::fs::{MetadataExt, chown};
    if !rustix::process::geteuid().is_root() {
        return;
    }
    let (_base, folder) = new_folder(&[viewer("anna")]);
    let files = [
        folder.path().to_owned(),
        folder.people_file(),
        folder.passwords_file(),
    ];
    for path in &files {
        chown(path, Some(12345), Some(12346)).unwrap();
    }
    add(&folder, &[viewer("ben")]).unwrap();
    remove(&folder, &["anna".into()]).unwrap();
    for path in &files {
        let owner = fs::metadata(path).unwrap();
        let ids = (owner.uid(), owner.gid());
        assert_eq!(ids, (12345, 12346), "{}", path.display());
    }
}

#[test]
fn init_completes_an_interrupted_run() {
    let (_base, folder) = new_folder(&[viewer("anna")]);
    let [[ca, _], [daemon, daemon_key]] = [folder.authority(), folder.daemon()];
    for lost in [&ca, &daemon, &daemon_key] {
        fs::remove_file(lost).unwrap();
        init(&folder, &[], &[]).unwrap();
        assert!(lost.exists());
    }
    fs::remove_file(&folder.authority()[1]).unwrap();
    let rejected = add(&folder, &[viewer("ben")]);
    assert!(matches!(rejected, Err(AuthError::NoAuthority(_))));
    assert_eq!(folder.people().unwrap().people.len(), 1);
}

#[test]
fn concurrent_additions_and_removals_all_take_effect() {
    let (_base, folder) = new_folder(&[viewer("evil")]);
    std::thread::scope(|scope| {
        scope.spawn(|| remove(&folder, &["evil".into()]).unwrap());
        for name in ["a", "b", "c", "d"] {
            let folder = &folder;
            scope.spawn(move || add(folder, &[viewer(name)]).unwrap());
        }
    });
    assert_eq!(names(&folder), ["a", "b", "c", "d"].map(|it| [it; 2]));
}

#[test]
fn the_next_change_removes_what_is_left_of_unknown_users() {
    let (_base, folder) = new_folder(&[viewer("anna")]);
    type Change = fn(&Folder);
    let changes: [Change; 3] = [
        |folder| drop(init(folder, &[], &[viewer("anna")]).unwrap()),
        |folder| drop(add(folder, &[viewer("ben")]).unwrap()),
        |folder| remove(folder, &["ben".into()]).unwrap(),
    ];
    for change in changes {
        let known = folder.people().unwrap();
        add(&folder, &[viewer("ghost")]).unwrap();
        // As after a removal that is interrupted at once.
        folder.write_people(&known).unwrap();
        let rights = Rights::read(folder.clone()).unwrap();
        let warning = &rights.expiry_warnings(60).unwrap()[0];
        assert!(warning.contains("`jostled auth remove ghost`"), "{warning}");
        change(&folder);
        assert!(!folder.person_folder("ghost").exists() && folder.person_folder("anna").exists());
        let passwords = folder.passwords().unwrap();
        assert!(passwords.iter().all(|(name, _)| name != "ghost"));
    }
    // As after an interrupted run, which has not recorded when the certificate expires.
    let mut known = folder.people().unwrap();
    known.until = None;
    folder.write_people(&known).unwrap();
    init(&folder, &[], &[]).unwrap();
    assert_eq!(folder.people().unwrap().until, Some(in_days(DAYS)));
    let other = (String::from("anna"), Role::Operator);
    let rejected = init(&folder, &[], &[other]);
    assert!(matches!(rejected, Err(AuthError::Exists(_))));
    let rejected = add(&folder, &[viewer(DAEMON)]);
    assert!(matches!(rejected, Err(AuthError::Name(_))));
}

#[test]
fn an_error_changes_nothing() {
    let base = tempfile::tempdir().unwrap();
    let folder = Folder::new(base.path().join("auth"));
    let rejected = add(&folder, &[viewer("anna")]);
    assert!(matches!(rejected, Err(AuthError::NoUsers(_))));
    let rejected = init(&folder, &[], &[viewer("anna"), viewer("anna")]);
    assert!(matches!(rejected, Err(AuthError::Duplicate(_))));
    assert!(!folder.path().exists());
    init(&folder, &[], &[viewer("anna")]).unwrap();
    let people = folder.people().unwrap();
    let operator = (String::from("anna"), Role::Operator);
    for rejected in [
        init(&folder, &["lab.example".into()], &[operator]),
        add(&folder, &[viewer("ben"), viewer("anna")]),
        add(&folder, &[viewer("ben"), viewer("ben")]),
        add(&folder, &[viewer("ben"), viewer("ben-1")]),
        remove(&folder, &["anna".into(), "ben".into()]).map(|()| Vec::new()),
    ] {
        let rejected = rejected.unwrap_err().to_string();
        let is_named = rejected.contains("anna") || rejected.contains("ben");
        assert!(is_named, "{rejected}");
        assert_eq!(folder.people().unwrap(), people);
        assert!(!folder.person_folder("ben").exists() && folder.person_folder("anna").exists());
    }
    remove(&folder, &["anna".into()]).unwrap();
    assert!(folder.people().unwrap().people.is_empty() && folder.passwords().unwrap().is_empty());
    assert!(!folder.person_folder("anna").exists());
    for strange in "no such host,,lab..example,tls/lab:7447,[::1],10.0.0.300".split(',') {
        let rejected = init(&folder, &[strange.into()], &[]);
        assert!(matches!(rejected, Err(AuthError::Host(_))), "{strange}");
    }
    let hosts = ["10.0.0.1", "fe80::1", "lab-1.example"].map(str::to_owned);
    init(&folder, &hosts, &[]).unwrap();
}

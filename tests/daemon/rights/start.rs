//! Who gets a session, and configurations that do not start.

use std::process::Stdio;
use std::time::{Duration, Instant};

use jostle_proto::keys;
use jostled::auth::folder::Folder;
use jostled::auth::issue;
use jostled::health::probe::Probe;

use super::{AuthDaemon, PEOPLE, SessionCredentials};
use crate::support::process::jostled;
use crate::support::{NODE, PREFIX};

/// The time within which a rejected client gets an error.
const SHORT_TIMEOUT: Duration = Duration::from_secs(3);

#[tokio::test(flavor = "multi_thread")]
async fn only_people_with_their_own_proof_get_a_session() {
    let daemon = AuthDaemon::start().await;
    let stranger = Folder::new(daemon.base.path().join("elsewhere"));
    let people = PEOPLE.map(|(name, role)| (name.to_owned(), role));
    issue::init(&stranger, &[], &people).unwrap();
    let own = |name| SessionCredentials::of(&daemon.folder, name);
    let password = |user: &str, password: &str| SessionCredentials {
        user: Some((user.to_owned(), password.to_owned())),
        ..own("olga")
    };
    let foreign = SessionCredentials {
        user: own("olga").user,
        authority: own("olga").authority,
        certificate: SessionCredentials::of(&stranger, "olga").certificate,
    };
    let trusting = SessionCredentials {
        authority: SessionCredentials::of(&stranger, "olga").authority,
        ..own("olga")
    };
    let rejected = [
        (
            "no name",
            SessionCredentials {
                user: None,
                ..own("olga")
            },
        ),
        ("a wrong password", password("olga", "guess")),
        ("nobody's name", password("nobody", "guess")),
        (
            "another's password",
            password("vera", &daemon.credentials("olga").password),
        ),
    ];
    let rejected_by_tls = [
        (
            "no certificate",
            SessionCredentials {
                certificate: None,
                ..own("olga")
            },
        ),
        ("another authority's certificate", foreign),
        ("trust in another authority", trusting),
    ];
    for protocol in ["tls", "tcp"] {
        let endpoint = daemon.endpoint(protocol);
        let by_tls = rejected_by_tls.iter().filter(|_| protocol == "tls");
        for (what, credentials) in rejected.iter().chain(by_tls) {
            let began = Instant::now();
            assert!(
                credentials.open(endpoint).await.is_err(),
                "{what} by {protocol}"
            );
            assert!(
                began.elapsed() < SHORT_TIMEOUT,
                "{what} by {protocol}: {:?}",
                began.elapsed()
            );
        }
        let session = own("vera").open(endpoint).await.unwrap();
        let hello = session
            .get(keys::node_get(PREFIX, NODE, "hello"))
            .await
            .unwrap();
        assert!(
            hello.recv_async().await.unwrap().result().is_ok(),
            "{protocol}"
        );
        session.close().await.unwrap();
    }
    // The daemon probes its own listeners, and each replies.
    for endpoint in &daemon.server.endpoints {
        let probe = Probe::of(endpoint).unwrap();
        probe.try_once().unwrap_or_else(|deaf| panic!("{deaf}"));
    }
    // A session with one person's name and another's certificate has no permissions.
    let mixed = SessionCredentials {
        certificate: own("olga").certificate,
        ..own("vera")
    };
    let session = mixed.open(daemon.endpoint("tls")).await.unwrap();
    let hello = session
        .get(keys::node_get(PREFIX, NODE, "hello"))
        .await
        .unwrap();
    assert!(hello.recv_async().await.is_err());
    session.close().await.unwrap();
    daemon.close(Vec::new()).await;
}

#[test]
fn what_others_could_reach_unasked_does_not_start() {
    let base = tempfile::tempdir().unwrap();
    let auth = base.path().join("auth");
    let folder = Folder::new(auth.clone());
    issue::init(&folder, &[], &[("anna".into(), PEOPLE[0].1)]).unwrap();
    let (auth, data) = (auth.to_str().unwrap(), base.path().join("data"));
    let data = data.to_str().unwrap();
    let nowhere = base.path().join("nowhere");
    for (flags, expected) in [
        (&["--listen", "tcp/0.0.0.0:0"][..], "is not encrypted"),
        (
            &["--listen", "tcp/0.0.0.0:0", "--auth-dir", auth],
            "is not encrypted",
        ),
        (
            &["--listen", "tls/0.0.0.0:0"],
            "set auth_dir to their folder",
        ),
        (
            &[
                "--listen",
                "tls/127.0.0.1:0#enable_mtls=false",
                "--auth-dir",
                auth,
            ],
            "only iface=NAME",
        ),
        (
            &["--listen", "tls/127.0.0.1:0"],
            "set auth_dir to their folder",
        ),
        (
            &["--auth-dir", nowhere.to_str().unwrap()],
            "jostled auth init",
        ),
        (
            &["--http", "0.0.0.0:0", "--auth-dir", auth],
            "and is not encrypted",
        ),
        (
            &["--http", "https://0.0.0.0:0"],
            "set auth_dir to their folder",
        ),
    ] {
        let mut command = jostled(&["--data-dir", data]);
        if !flags.contains(&"--listen") {
            command.args(["--listen", "tcp/127.0.0.1:0"]);
        }
        let ended = command.args(flags).stderr(Stdio::piped()).output().unwrap();
        let text = String::from_utf8(ended.stderr).unwrap();
        assert_eq!(ended.status.code(), Some(2), "{flags:?}: {text}");
        assert!(text.contains(expected), "{flags:?}: {text}");
    }
}

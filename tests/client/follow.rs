//! Follows a swarm of a daemon in a process of its own, which is killed and started again.

use std::cell::Cell;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant, SystemTime};

use jostle_client::{Client, ConnectOptions, Error, EventsFrom, Follow, FollowOptions, Update};
use jostle_proto::verbs::{
    AnnotateArgs, CreateArgs, DeleteArgs, Return, RunArgs, SetArgs, StepArgs,
};
use jostle_proto::{EventKind, Spec, keys};
use tempfile::TempDir;
use zenoh::Session;
use zenoh::bytes::Encoding;
use zenoh::liveliness::LivelinessToken;

use crate::daemon::{Daemon, serve};

/// Makes a copy of this program a daemon: its folder and its endpoint.
const DAEMON: &str = "JOSTLE_CLIENT_TEST_DAEMON";

/// The first chunk of the keys of daemons by default.
const PREFIX: &str = "jostle";

/// The timeout of each update, on a machine that runs other tests.
const TIMEOUT: Duration = Duration::from_secs(60);

/// The daemon process; ends with the test.
pub struct Process(Child);

impl Process {
    pub fn start(folder: &Path, listen: &str) -> (Self, String) {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["follow::daemon_process", "--exact", "--nocapture"])
            .env(DAEMON, format!("{} {listen}", folder.display()))
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let mut endpoints =
            lines.filter_map(|it| Some(it.unwrap().split_once("listening on ")?.1.to_owned()));
        let endpoint = endpoints.next().unwrap();
        (Process(child), endpoint)
    }

    /// Suspends it, and waits until all of its threads have stopped; an end works as before.
    pub fn suspend(&self) {
        signal(&self.0, "STOP");
        let id = self.0.id().to_string();
        let threads = Path::new("/proc").join(&id).join("task");
        let is_stopped = |thread: std::io::Result<std::fs::DirEntry>| {
            // The state follows the name, which is in parentheses.
            let stat = std::fs::read_to_string(thread.unwrap().path().join("stat"));
            stat.is_ok_and(|stat| stat.rsplit(')').next().unwrap().starts_with(" T"))
        };
        let began = Instant::now();
        while !std::fs::read_dir(&threads).unwrap().all(is_stopped) {
            assert!(began.elapsed() < TIMEOUT, "it runs after SIGSTOP");
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Resumes it.
    pub fn resume(&self) {
        signal(&self.0, "CONT");
    }

    pub fn kill(mut self) {
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }
}

/// Sends a signal to a process.
pub fn signal(process: &Child, name: &str) {
    let (name, id) = (format!("-{name}"), process.id().to_string());
    let status = Command::new("kill").args([name, id]).status().unwrap();
    assert!(status.success());
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Not a test: the daemon, in a copy of this program.
#[tokio::test(flavor = "multi_thread")]
async fn daemon_process() {
    let Ok(arguments) = std::env::var(DAEMON) else {
        return;
    };
    let (folder, listen) = arguments.split_once(' ').unwrap();
    let server = serve(Path::new(folder), listen).await;
    println!("listening on {}", server.endpoints[0]);
    std::future::pending::<()>().await;
}

async fn next(updates: &mut Follow) -> Option<Result<Update, Error>> {
    tokio::time::timeout(TIMEOUT, updates.next()).await.unwrap()
}

/// Skips to the first update of which `take` returns something.
async fn until<T>(updates: &mut Follow, mut take: impl FnMut(&Update) -> Option<T>) -> T {
    loop {
        let update = next(updates).await.unwrap().unwrap();
        if let Some(taken) = take(&update) {
            return taken;
        }
    }
}

async fn create(client: &Client) {
    let args = CreateArgs {
        name: "demo".into(),
        spec: Spec {
            rate: Some(1.0),
            ..Spec::new(10)
        },
        exist_ok: false,
    };
    client.create(&args).await.unwrap();
}

fn note(text: &str) -> AnnotateArgs {
    AnnotateArgs { text: text.into() }
}

fn is_note(update: &Update, text: &str) -> Option<()> {
    let Update::Event(event) = update else {
        return None;
    };
    let EventKind::Command { verb, args, .. } = &event.event else {
        return None;
    };
    (verb == "annotate" && args["text"] == text).then_some(())
}

/// A daemon with the swarm `demo`: its folder, its process, its endpoint and a client of it.
async fn daemon_with_a_swarm() -> (TempDir, Process, String, Client) {
    let folder = tempfile::tempdir().unwrap();
    let (daemon, endpoint) = Process::start(folder.path(), "tcp/127.0.0.1:0");
    let client = Client::connect(ConnectOptions::to(&*endpoint))
        .await
        .unwrap();
    create(&client).await;
    (folder, daemon, endpoint, client)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_swarm_is_followed_through_a_kill_and_a_restart_until_it_is_deleted() {
    let (folder, daemon, endpoint, client) = daemon_with_a_swarm().await;
    client.execute("demo", &RunArgs::default()).await.unwrap();
    let options = FollowOptions {
        status: true,
        states: Some(4),
        order: Some(4),
        events: Some(EventsFrom::After(0)),
    };
    let mut updates = client.follow("demo", options).await.unwrap();
    let first = next(&mut updates).await.unwrap().unwrap();
    assert!(matches!(first, Update::Status(status) if status.epoch == 1));
    let second = next(&mut updates).await.unwrap().unwrap();
    assert!(matches!(second, Update::State(state) if state.x.len() == 10));
    let third = next(&mut updates).await.unwrap().unwrap();
    let is_created = |update: &Update| matches!(update, Update::Event(event) if event.number == 1 && matches!(event.event, EventKind::Created { .. }));
    assert!(is_created(&third), "{third:?}");
    client.execute("demo", &note("before")).await.unwrap();
    until(&mut updates, |it| is_note(it, "before")).await;

    daemon.kill();
    until(&mut updates, |it| matches!(it, Update::Away).then_some(())).await;
    let (_daemon, _) = Process::start(folder.path(), &endpoint);
    until(&mut updates, |it| matches!(it, Update::Back).then_some(())).await;
    let epoch = until(&mut updates, |it| match it {
        Update::Restarted { epoch } => Some(*epoch),
        _ => None,
    });
    assert_eq!(epoch.await, 2);
    client.execute("demo", &note("after")).await.unwrap();
    until(&mut updates, |it| is_note(it, "after")).await;
    until(&mut updates, |it| match it {
        Update::State(state) if state.epoch == 2 => Some(()),
        _ => None,
    })
    .await;

    client.execute("demo", &DeleteArgs {}).await.unwrap();
    until(&mut updates, |it| {
        matches!(it, Update::Deleted).then_some(())
    })
    .await;
    assert!(next(&mut updates).await.is_none());
    client.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_that_comes_back_without_the_swarm_ends_the_stream() {
    let folders = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let (daemon, endpoint) = Process::start(folders[0].path(), "tcp/127.0.0.1:0");
    let client = Client::connect(ConnectOptions::to(&*endpoint))
        .await
        .unwrap();
    create(&client).await;
    let mut updates = client
        .follow("demo", FollowOptions::default())
        .await
        .unwrap();
    daemon.kill();
    let away = next(&mut updates).await.unwrap().unwrap();
    assert!(matches!(away, Update::Away), "{away:?}");
    let (_daemon, _) = Process::start(folders[1].path(), &endpoint);
    let ended = next(&mut updates).await.unwrap();
    assert!(
        matches!(ended, Err(Error::NotRecovered { .. })),
        "{ended:?}"
    );
    assert!(next(&mut updates).await.is_none());
    client.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_suspended_daemon_is_not_one_without_swarms() {
    let (_folder, daemon, _, client) = daemon_with_a_swarm().await;
    assert_eq!(client.swarms().await.unwrap(), ["demo"]);
    daemon.suspend();
    let swarms = client.swarms().await;
    assert!(matches!(swarms, Err(Error::TimedOut { .. })), "{swarms:?}");
    daemon.kill();
    client.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn events_without_gaps_and_errors_with_their_variant() {
    let daemon = Daemon::start().await;
    let client = Client::connect(ConnectOptions::to(daemon.endpoint()))
        .await
        .unwrap();
    let options = FollowOptions {
        status: true,
        ..FollowOptions::default()
    };
    let error = client.follow("demo", options).await.unwrap_err();
    assert!(matches!(error, Error::NoSwarm { .. }), "{error}");
    create(&client).await;
    let options = FollowOptions {
        events: Some(EventsFrom::After(0)),
        ..FollowOptions::default()
    };
    let mut updates = client.follow("demo", options).await.unwrap();
    // More than the queue of events holds.
    for number in 0..200 {
        let set = SetArgs {
            pi3: Some(1.0 + f64::from(number) / 1000.0),
            ..SetArgs::default()
        };
        client.execute("demo", &set).await.unwrap();
    }
    client.execute("demo", &note("last")).await.unwrap();
    let mut numbers = Vec::new();
    until(&mut updates, |it| {
        if let Update::Event(event) = it {
            numbers.push(event.number);
        }
        is_note(it, "last")
    })
    .await;
    let expected: Vec<u64> = (1..=numbers.len() as u64).collect();
    assert_eq!(numbers, expected);
    assert!(numbers.len() > 200);
    client.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_dropped_next_loses_no_update() {
    let daemon = Daemon::start().await;
    let client = Client::connect(ConnectOptions::to(daemon.endpoint()))
        .await
        .unwrap();
    create(&client).await;
    let options = FollowOptions {
        events: Some(EventsFrom::After(0)),
        ..FollowOptions::default()
    };
    let mut updates = client.follow("demo", options).await.unwrap();
    let dropped = Cell::new(0);
    let send = async {
        let mut number = 0;
        // More than the queue of events holds, so that some are queried.
        while number < 200 || dropped.get() < 100 {
            let set = SetArgs {
                pi3: Some(1.0 + f64::from(number) / 1000.0),
                ..SetArgs::default()
            };
            client.execute("demo", &set).await.unwrap();
            number += 1;
        }
        client.execute("demo", &note("last")).await.unwrap();
    };
    let read = async {
        let (mut numbers, began) = (Vec::new(), Instant::now());
        loop {
            let micros = Duration::from_micros(50 * (dropped.get() % 40));
            tokio::select! {
                biased;
                update = updates.next() => {
                    let update = update.unwrap().unwrap();
                    if let Update::Event(event) = &update {
                        numbers.push(event.number);
                    }
                    if is_note(&update, "last").is_some() {
                        return numbers;
                    }
                }
                () = tokio::time::sleep(micros) => dropped.set(dropped.get() + 1),
            }
            assert!(began.elapsed() < TIMEOUT);
        }
    };
    let ((), numbers) = tokio::join!(send, read);
    let expected: Vec<u64> = (1..=numbers.len() as u64).collect();
    assert_eq!(numbers, expected);
    client.close().await;
}

/// Declares the tokens of the daemon `a` and of the swarm `demo` on it.
async fn declare(session: &Session) -> [LivelinessToken; 2] {
    let swarm = keys::alive(PREFIX, "demo", "a");
    let node = session
        .liveliness()
        .declare_token(keys::node_alive(PREFIX, "a"));
    let swarm = session.liveliness().declare_token(swarm);
    [node.await.unwrap(), swarm.await.unwrap()]
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_received_before_the_token_of_a_swarm_that_is_back_follows_the_news_of_it() {
    // The order in which a restored connection brings them is not the daemon's to choose.
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", "\"router\""),
        ("listen/endpoints", "[\"tcp/127.0.0.1:0\"]"),
        ("scouting/multicast/enabled", "false"),
        ("scouting/gossip/enabled", "false"),
    ] {
        config.insert_json5(key, value).unwrap();
    }
    let session = zenoh::open(config).await.unwrap();
    let tokens = declare(&session).await;
    let endpoint = session.info().locators().await[0].to_string();
    let client = Client::connect(ConnectOptions {
        wait: Duration::ZERO,
        ..ConnectOptions::to(endpoint)
    });
    let client = client.await.unwrap();
    let options = FollowOptions {
        events: Some(EventsFrom::Now),
        ..FollowOptions::default()
    };
    let began = Instant::now();
    let mut updates = loop {
        match client.follow("demo", options).await {
            Ok(updates) => break updates,
            // The client has not received the tokens yet, and the session of this test answers no query.
            Err(error) => assert!(began.elapsed() < TIMEOUT, "{error}"),
        }
    };
    for token in tokens {
        token.undeclare().await.unwrap();
    }
    let update = next(&mut updates).await.unwrap().unwrap();
    assert!(matches!(update, Update::Away), "{update:?}");
    let event = include_str!("../../proto/fixtures/event.phase.json").replace("school", "demo");
    session
        .put(keys::event(PREFIX, "demo"), event)
        .await
        .unwrap();
    let early = tokio::time::timeout(Duration::from_millis(300), updates.next()).await;
    assert!(early.is_err(), "{early:?}");
    let _tokens = declare(&session).await;
    let update = next(&mut updates).await.unwrap().unwrap();
    assert!(matches!(update, Update::Back), "{update:?}");
    let update = next(&mut updates).await.unwrap().unwrap();
    assert!(matches!(update, Update::Event(_)), "{update:?}");
    client.close().await;
    session.close().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_published_state_has_its_times_and_one_that_was_queried_has_none() {
    let (_folder, _daemon, _, client) = daemon_with_a_swarm().await;
    let options = FollowOptions {
        states: Some(1),
        ..FollowOptions::default()
    };
    let mut updates = client.follow("demo", options).await.unwrap();
    let state = |it: &Update| match it {
        Update::State(state) => Some(state.clone()),
        _ => None,
    };
    let queried = until(&mut updates, state).await;
    assert!(queried.attachment().is_none() && queried.received_at().is_none());
    assert_eq!((queried.published_at(), queried.stepped_at()), (None, None));
    assert_eq!(queried.latency(), None);
    let began = SystemTime::now();
    loop {
        let step = StepArgs {
            steps: 1,
            return_: Return::None,
        };
        let reached = client.execute("demo", &step).await.unwrap().step;
        client.status("demo").await.unwrap();
        let read = SystemTime::now();
        let state = until(&mut updates, |it| state(it).filter(|it| it.step >= reached)).await;
        let stepped = state.stepped_at().unwrap();
        let published = state.published_at().unwrap();
        let received = state.received_at().unwrap();
        assert!(began <= stepped && stepped <= published && published <= received);
        let latency = received.duration_since(published).unwrap().as_secs_f64();
        assert_eq!(state.latency(), Some(latency));
        assert!(state.attachment().unwrap().sequences.is_empty());
        // The time in the queue does not count.
        if received <= read {
            break;
        }
    }
    client.close().await;
}

/// The encoding of states.
const CBOR: Encoding = Encoding::APPLICATION_CBOR;

/// Publishes what belongs on other keys, as zenoh sometimes delivers it after a connection was restored.
async fn misdeliver(session: &Session) {
    let event = include_str!("../../proto/fixtures/event.phase.json");
    let order = include_str!("../../proto/fixtures/order.json");
    let state: &[u8] = include_bytes!("../../proto/fixtures/state.cbor");
    let event = event.replace("\"school\"", "\"demo\"");
    let order = order.replace("\"school\"", "\"demo\"");
    assert!(event.contains("\"demo\"") && order.contains("\"demo\""));
    for (key, others) in [
        (keys::state(PREFIX, "demo"), [&event, &order]),
        (keys::order(PREFIX, "demo"), [&event, &event]),
        (keys::event(PREFIX, "demo"), [&order, &order]),
    ] {
        for other in others {
            let put = session.put(&key, other.as_str());
            put.encoding(Encoding::APPLICATION_JSON).await.unwrap();
        }
        // Of another swarm too; on the key of the states it is a state.
        session.put(&key, state).encoding(CBOR).await.unwrap();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_belongs_on_another_key_is_left_out_and_what_it_may_have_replaced_is_queried() {
    let (_folder, _daemon, endpoint, other) = daemon_with_a_swarm().await;
    // A daemon passes on nothing that others put on its keys, a router does.
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", "\"router\"".to_owned()),
        ("connect/endpoints", format!("[\"{endpoint}\"]")),
        ("listen/endpoints", "[\"tcp/127.0.0.1:0\"]".to_owned()),
        ("scouting/multicast/enabled", "false".to_owned()),
    ] {
        config.insert_json5(key, &value).unwrap();
    }
    let session = zenoh::open(config).await.unwrap();
    let endpoint = session.info().locators().await[0].to_string();
    let client = Client::connect(ConnectOptions {
        timeout: TIMEOUT,
        ..ConnectOptions::to(endpoint)
    });
    let client = client.await.unwrap();
    let began = Instant::now();
    while client.status("demo").await.is_err() {
        assert!(
            began.elapsed() < TIMEOUT,
            "the router does not reach the daemon"
        );
    }
    let options = FollowOptions {
        states: Some(64),
        order: Some(64),
        events: Some(EventsFrom::After(0)),
        ..FollowOptions::default()
    };
    let mut updates = client.follow("demo", options).await.unwrap();
    let mut numbers = Vec::new();
    let mut step = |update: &Update| match update {
        Update::Event(event) => {
            assert_eq!(event.swarm, "demo");
            numbers.push(event.number);
            None
        }
        Update::State(state) => {
            assert_eq!((&*state.swarm, state.x.len()), ("demo", 10));
            Some(state.step)
        }
        Update::Order(order) => {
            assert_eq!((&*order.swarm, order.n), ("demo", 10));
            None
        }
        update => panic!("{update:?}"),
    };
    assert_eq!(until(&mut updates, &mut step).await, 0);
    for round in 0..3 {
        misdeliver(&session).await;
        // It is paused and publishes nothing: this state was queried.
        until(&mut updates, |it| step(it).filter(|it| *it == round)).await;
        other.execute("demo", &note("lost")).await.unwrap();
        let args = StepArgs {
            steps: 1,
            return_: Return::None,
        };
        other.execute("demo", &args).await.unwrap();
        until(&mut updates, |it| step(it).filter(|it| *it == round + 1)).await;
    }
    other.execute("demo", &note("last")).await.unwrap();
    until(&mut updates, |it| {
        step(it);
        is_note(it, "last")
    })
    .await;
    let expected: Vec<u64> = (1..=numbers.len() as u64).collect();
    assert_eq!(numbers, expected);
    other.execute("demo", &DeleteArgs {}).await.unwrap();
    until(&mut updates, |it| {
        matches!(it, Update::Deleted).then_some(())
    })
    .await;
    session.close().await.unwrap();
    other.close().await;
    client.close().await;
}

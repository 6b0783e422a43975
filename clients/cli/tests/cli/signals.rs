//! `record` with a signal right after its start: it loses no data and leaves no files.

use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use jostle_results::recording;
use serde_json::Value;

use crate::support::{Canned, Daemon, Link, Running, TIMEOUT};

/// The signals, with their numbers.
const SIGNALS: [(&str, i32); 3] = [("INT", 2), ("TERM", 15), ("HUP", 1)];

/// How often each signal is sent at an arbitrary moment.
const TIMES: usize = 50;

/// How many clients run at once.
const AT_ONCE: usize = 6;

/// How a client ended.
struct Outcome {
    status: ExitStatus,
    stderr: String,
    folder: tempfile::TempDir,
    file: PathBuf,
}

/// Starts `jostle record demo` to a file of its own.
fn begin(endpoint: &str, options: &str) -> (Child, tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("take.mcap");
    let child = Command::new(env!("CARGO_BIN_EXE_jostle"))
        .args(["record", "demo", "-o"])
        .arg(&file)
        .args(options.split_whitespace())
        .env("JOSTLE_ENDPOINT", endpoint)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    (child, folder, file)
}

fn send(signal: &str, pid: u32) {
    let kill = Command::new("kill")
        .args(["-s", signal, &pid.to_string()])
        .status();
    assert!(kill.unwrap().success(), "{signal}");
}

/// Waits until a client has ended, for up to [`TIMEOUT`].
fn end((mut child, folder, file): (Child, tempfile::TempDir, PathBuf)) -> Outcome {
    let deadline = Instant::now() + TIMEOUT;
    while child.try_wait().unwrap().is_none() {
        if Instant::now() > deadline {
            child.kill().unwrap();
            panic!("the signal was lost: the client records on");
        }
        thread::sleep(Duration::from_millis(5));
    }
    let output = child.wait_with_output().unwrap();
    Outcome {
        status: output.status,
        stderr: String::from_utf8(output.stderr).unwrap(),
        folder,
        file,
    }
}

/// The number of states in a file, which must be complete and readable.
fn states(file: &Path) -> u64 {
    let mut states = 0;
    let about = recording::read(file, |message| {
        states += u64::from(message.topic == "state");
        Ok(())
    });
    let about = about.unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    assert_eq!(about["frames"], states.to_string(), "{about:?}");
    states
}

impl Outcome {
    fn names(&self) -> Vec<String> {
        let entries = fs::read_dir(self.folder.path()).unwrap();
        entries
            .map(|it| it.unwrap().file_name().into_string().unwrap())
            .collect()
    }

    /// The client completed a file, and left nothing else.
    fn assert_recorded(&self, context: &str) {
        assert_eq!(self.status.code(), Some(0), "{context}: {}", self.stderr);
        assert_eq!(self.names(), ["take.mcap"], "{context}: {}", self.stderr);
        states(&self.file);
    }

    /// The client has no file, left nothing and printed so.
    fn assert_interrupted(&self, context: &str) {
        assert_eq!(self.status.code(), Some(130), "{context}: {}", self.stderr);
        assert!(self.names().is_empty(), "{context}: {:?}", self.names());
        let said = "interrupted: nothing was recorded";
        assert!(self.stderr.contains(said), "{context}: {}", self.stderr);
    }

    /// One of both, or the signal came before the process could handle any.
    fn assert_one_of_all(&self, number: i32, context: &str) {
        match self.status.code() {
            Some(0) => self.assert_recorded(context),
            Some(_) => self.assert_interrupted(context),
            None => {
                assert_eq!(self.status.signal(), Some(number), "{context}");
                assert!(self.names().is_empty(), "{context}: {:?}", self.names());
                assert_eq!(self.stderr, "", "{context}");
            }
        }
    }
}

/// A daemon with a running swarm.
async fn daemon() -> Daemon {
    let daemon = Daemon::start().await;
    daemon
        .said("create demo --n 5 --publish-every 1 --rate 1")
        .await;
    daemon.said("run demo").await;
    daemon
}

/// Asserts that the daemon has no recording.
async fn assert_none_left(daemon: &Daemon, context: &str) {
    let list = daemon.reply("record --list").await;
    let left = &list["result"]["recordings"];
    assert_eq!(left, &Value::Array(vec![]), "{context}");
}

/// Sends each signal [`TIMES`] times, the n-th after `pause(n)`; how many clients handled it.
async fn often(options: &'static str, pause: fn(usize) -> Duration) -> usize {
    let daemon = daemon().await;
    let mut handled = 0;
    for (signal, number) in SIGNALS {
        let next = Arc::new(AtomicUsize::new(0));
        let threads: Vec<_> = (0..AT_ONCE)
            .map(|_| {
                let (next, endpoint) = (next.clone(), daemon.endpoint.clone());
                thread::spawn(move || {
                    let mut handled = 0;
                    loop {
                        let time = next.fetch_add(1, Ordering::SeqCst);
                        if time >= TIMES {
                            return handled;
                        }
                        let running = begin(&endpoint, options);
                        thread::sleep(pause(time));
                        send(signal, running.0.id());
                        let outcome = end(running);
                        outcome.assert_one_of_all(number, &format!("{signal} {time}"));
                        handled += usize::from(outcome.status.code().is_some());
                    }
                })
            })
            .collect();
        for thread in threads {
            handled += thread.join().unwrap();
        }
        assert!(next.load(Ordering::SeqCst) >= TIMES);
    }
    assert_none_left(&daemon, "after all signals").await;
    daemon.stop().await;
    handled
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_signal_right_after_the_start_ends_a_recording() {
    often("", |_| Duration::ZERO).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_signal_right_after_the_start_ends_a_recording_of_published_states() {
    often("--published", |_| Duration::ZERO).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_signal_at_any_early_moment_ends_a_recording() {
    // From before the handlers are installed to well after the recording has begun.
    let handled = often("", |time| Duration::from_millis(4 * time as u64)).await;
    assert!(handled > TIMES / 2, "only {handled} clients got so far");
}

/// When the request at which a signal is sent reaches the daemon.
#[derive(Clone, Copy, PartialEq)]
enum Forward {
    /// Right after the signal is sent: the client may receive the reply before it handles the signal.
    AtOnce,
    /// After the client has ended, or after [`TIMEOUT`].
    AfterTheEnd,
}

/// Sends a signal when the client sends a request that contains `moment`, before the daemon gets it.
fn signal_at(
    moment: &'static str,
    forward: Forward,
    options: &str,
    signal: &'static str,
    daemon: &Daemon,
) -> Outcome {
    let pid = Arc::new(AtomicU32::new(0));
    let (link, to) = (Link::to(&daemon.endpoint), pid.clone());
    let is_met = link.on(moment.as_bytes(), move || {
        while to.load(Ordering::SeqCst) == 0 {
            thread::sleep(Duration::from_millis(1));
        }
        let pid = to.load(Ordering::SeqCst);
        send(signal, pid);
        let deadline = Instant::now() + TIMEOUT;
        let has_ended = || !Path::new(&format!("/proc/{pid}")).exists();
        while forward == Forward::AfterTheEnd && !has_ended() && Instant::now() < deadline {
            thread::sleep(Duration::from_millis(1));
        }
    });
    let running = begin(&link.endpoint, options);
    pid.store(running.0.id(), Ordering::SeqCst);
    let outcome = end(running);
    let is_met = is_met.load(Ordering::SeqCst);
    assert!(is_met, "no request with {moment}: {}", outcome.stderr);
    outcome
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_signal_while_the_daemon_begins_a_recording_ends_it_there_too() {
    let daemon = daemon().await;
    for (signal, _) in SIGNALS {
        for moment in ["cmd/record", "get/recordings"] {
            let context = format!("{signal} at {moment}");
            let outcome = signal_at(moment, Forward::AtOnce, "", signal, &daemon);
            outcome.assert_recorded(&context);
            assert_none_left(&daemon, &context).await;
        }
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_signal_before_the_first_published_state_leaves_no_file() {
    let daemon = daemon().await;
    for (signal, number) in SIGNALS {
        for moment in ["demo/state", "demo/get/status", "demo/get/spec"] {
            let context = format!("{signal} at {moment}");
            let held = signal_at(moment, Forward::AfterTheEnd, "--published", signal, &daemon);
            held.assert_interrupted(&context);
            // The file may be begun before the client handles the signal.
            let raced = signal_at(moment, Forward::AtOnce, "--published", signal, &daemon);
            raced.assert_one_of_all(number, &context);
        }
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn leftovers_of_a_killed_client_do_not_prevent_a_recording() {
    let daemon = daemon().await;
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("take.mcap");
    // A client creates it to check that the folder is writable.
    fs::create_dir(folder.path().join("take.mcap.parts")).unwrap();
    let line = format!("record demo -o {} --steps 5", file.display());
    let ended = daemon.jostle(&line).await;
    assert_eq!(ended.code, Some(0), "{ended:?}");
    assert!(states(&file) > 0);
    let left = fs::read_dir(folder.path()).unwrap().count();
    assert_eq!(left, 1, "only the file");
    daemon.stop().await;
}

#[test]
fn a_client_that_waits_for_a_connection_ends_at_the_first_signal() {
    // As a suspended daemon: it accepts connections, and sends nothing.
    let silent = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let endpoint = format!("tcp/{}", silent.local_addr().unwrap());
    for options in ["--timeout 30", "--timeout 30 --published"] {
        let running = begin(&endpoint, options);
        thread::sleep(Duration::from_secs(1));
        send("INT", running.0.id());
        let began = Instant::now();
        let outcome = end(running);
        let took = began.elapsed();
        assert_eq!(outcome.status.code(), Some(130), "{}", outcome.stderr);
        assert!(took < Duration::from_secs(10), "{took:?}");
        assert_eq!(fs::read_dir(outcome.folder.path()).unwrap().count(), 0);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_signal_ends_results_into_a_folder_like_ctrl_c() {
    let canned = Canned::start().await;
    canned.hold();
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    for (signal, _) in SIGNALS {
        canned.take();
        let line = format!("experiment results order --timeout 60 -o {}", out.display());
        let mut running = Running::begin(&canned.endpoint, &line, "");
        canned.until_sent(1, &mut running).await;
        running.signal(&format!("-{signal}"));
        let ended = running.end().await;
        assert_eq!(ended.code, Some(130), "{signal}: {ended:?}");
        assert!(!out.exists(), "{signal}");
    }
    canned.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_under_nohup_ignores_that_its_terminal_is_closed() {
    let canned = Canned::start().await;
    canned.hold();
    let folder = tempfile::tempdir().unwrap();
    let mut client = Command::new("sh")
        .args(["-c", "trap '' HUP; exec \"$0\" \"$@\""])
        .arg(env!("CARGO_BIN_EXE_jostle"))
        .args(["experiment", "results", "order", "--timeout", "60", "-o"])
        .arg(folder.path().join("out"))
        .env("JOSTLE_ENDPOINT", &canned.endpoint)
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    while canned.take().is_empty() {
        assert!(client.try_wait().unwrap().is_none());
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    send("HUP", client.id());
    tokio::time::sleep(Duration::from_secs(1)).await;
    assert!(client.try_wait().unwrap().is_none());
    send("TERM", client.id());
    assert_eq!(client.wait().unwrap().code(), Some(130));
    canned.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn results_remove_what_a_killed_client_left_in_their_folder() {
    let daemon = Daemon::start().await;
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.toml");
    let text = "name = \"a\"\nduration = 2\nspec = { n = 5 }\n\
                measure = { series_every = 50, columns = [\"drift\"] }\n";
    fs::write(&file, text).unwrap();
    daemon
        .jostle(&format!("experiment run {}", file.display()))
        .await;
    let out = folder.path().join("out");
    let path = |name: &str| out.join(name);
    fs::create_dir(&out).unwrap();
    for name in ["series.parquet", "results.parquet", "results.csv", "other"] {
        fs::write(path(&format!(".jostle-{name}-x1y2z3")), "left").unwrap();
    }
    let in_use = jostle_atomic_file::begin(&path("series.parquet")).unwrap();
    for table in ["", "/other.csv", "/other.parquet"] {
        let line = format!("experiment results a -o {}{table}", out.display());
        daemon.said(&line).await;
    }
    let entries = fs::read_dir(&out).unwrap();
    let mut names: Vec<_> = entries.map(|it| it.unwrap().file_name()).collect();
    names.sort();
    let kept = in_use.path().file_name().unwrap().to_owned();
    let mut expected: Vec<_> = [
        "other.csv",
        "other.parquet",
        "results.csv",
        "results.parquet",
        "series.parquet",
        ".jostle-other-x1y2z3",
    ]
    .map(std::ffi::OsString::from)
    .into();
    expected.push(kept);
    expected.sort();
    assert_eq!(names, expected);
    daemon.stop().await;
}

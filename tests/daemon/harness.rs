//! The harness of the tests: tests that lack a tool fail unless they may be skipped, and `tests/within`
//! ends a command that takes too long.

use std::fs;
use std::hash::{BuildHasher as _, RandomState};
use std::net::TcpListener;
use std::os::unix::process::ExitStatusExt as _;
use std::path::Path;
use std::process::{Command, Output};
use std::time::{Duration, Instant};

use crate::support::small_disk::SmallDisk;

/// Distinct ports of this address on which no process listens, for daemons that are started with them
/// later.
///
/// They are below the ports that the kernel assigns itself: one of those, assigned to a socket that is
/// closed again, may be assigned to another process before the daemon listens on it.
pub fn free_ports<const N: usize>(address: &str) -> [u16; N] {
    let mut ports = [0; N];
    for k in 0..N {
        let mut drawn = (0..1000_u16)
            .map(|attempt| 10_000 + (RandomState::new().hash_one(attempt) % 22_000) as u16);
        let free =
            drawn.find(|port| !ports.contains(port) && TcpListener::bind((address, *port)).is_ok());
        ports[k] = free.expect("a free port");
    }
    ports
}

/// A test that needs a disk of its own, run by the test below as a process.
#[test]
fn a_test_of_a_small_disk() {
    if std::env::var("JOSTLE_TEST_HELPER").is_ok() {
        let _ = SmallDisk::mount(1);
    }
}

/// Runs that test without the right to mount.
fn run_without_the_right_to_mount(may_skip: &str, skipped: &Path) -> Output {
    let own = std::env::current_exe().unwrap();
    let mut command = if rustix::process::geteuid().is_root() {
        let mut command = Command::new("setpriv");
        command.args(["--bounding-set=-sys_admin", "--inh-caps=-sys_admin"]);
        command.arg(own);
        command
    } else {
        Command::new(own)
    };
    command
        .args(["--exact", "harness::a_test_of_a_small_disk"])
        .args(["--test-threads", "2"])
        .env("JOSTLE_TEST_HELPER", "")
        .env("JOSTLE_MAY_SKIP", may_skip)
        .env("JOSTLE_SKIPPED", skipped)
        .output()
        .unwrap()
}

#[test]
fn a_test_that_lacks_something_fails_unless_it_may_be_skipped_which_is_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let skipped = folder.path().join("skipped");
    for may_skip in ["", "libfiu", "mounts,faketime"] {
        let output = run_without_the_right_to_mount(may_skip, &skipped);
        let text = String::from_utf8_lossy(&output.stdout);
        assert_eq!(output.status.code(), Some(101), "{may_skip:?}: {text}");
        let remedy = "this test needs mount: run the tests as root";
        assert!(text.contains(remedy), "{may_skip:?}: {text}");
        assert!(!skipped.exists(), "{may_skip:?}");
    }
    let output = run_without_the_right_to_mount("libfiu, mount", &skipped);
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{text}");
    let line = "mount: harness::a_test_of_a_small_disk\n";
    assert_eq!(text, format!("skipped, needs {line}"));
    assert_eq!(fs::read_to_string(&skipped).unwrap(), line);
}

/// Runs a shell script with a time limit, as `./check` runs its stages.
fn run_with_time_limit(secs: &str, script: &str) -> (Output, Duration) {
    let began = Instant::now();
    let within = concat!(env!("CARGO_MANIFEST_DIR"), "/within");
    let output = Command::new(within)
        .args([secs, "bash", "-c", script])
        .output()
        .unwrap();
    (output, began.elapsed())
}

#[test]
fn a_command_that_ends_in_time_keeps_its_output_and_its_exit_code() {
    for (script, code, text) in [
        ("echo out; echo err >&2", 0, "out\nerr\n"),
        ("exit 7", 7, ""),
        ("kill -KILL $$", 137, ""),
        // A process that is left over is killed, and does not delay the command's end.
        ("sleep 600 & echo left", 0, "left\n"),
    ] {
        let (output, _) = run_with_time_limit("60", script);
        assert_eq!(output.status.code(), Some(code), "{script}");
        assert_eq!(String::from_utf8_lossy(&output.stdout), text, "{script}");
    }
}

#[test]
fn a_command_does_not_inherit_ignored_signals() {
    let within = concat!(env!("CARGO_MANIFEST_DIR"), "/within");
    for signal in ["INT", "TERM", "HUP"] {
        // As under nohup, and in the background of a script.
        let script = format!("trap '' {signal}; {within} 60 sh -c 'kill -{signal} $$; echo on'");
        let output = Command::new("bash").args(["-c", &script]).output().unwrap();
        assert_eq!(String::from_utf8_lossy(&output.stdout), "", "{signal}");
        assert!(!output.status.success(), "{signal}");
    }
}

#[test]
fn a_command_that_takes_too_long_is_killed_with_its_processes_and_the_running_test_named() {
    let folder = tempfile::tempdir().unwrap();
    let pids = folder.path().join("pids");
    // As the Rust harness reports: one ended, one ended late, one is running.
    let script = format!(
        "echo 'test a::quick ... ok'
         echo 'test b::late has been running for over 60 seconds'
         echo 'test c::stuck has been running for over 60 seconds'
         echo 'test b::late ... ok'
         sleep 600 & echo $! >>{0}
         setsid sleep 600 & echo $! >>{0}
         wait",
        pids.display()
    );
    let (output, took) = run_with_time_limit("1", &script);
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(124), "{text}");
    assert!(took < Duration::from_secs(60), "{took:?}");
    assert!(text.contains("took longer than 1 s: bash -c"), "{text}");
    assert!(text.contains("running: c::stuck\n"), "{text}");
    assert!(!text.contains("running: a::quick") && !text.contains("running: b::late"));
    for pid in fs::read_to_string(&pids).unwrap().lines() {
        let gone = || {
            let status = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
            // A killed process is a zombie until its parent waits for it.
            status.is_empty() || status.contains(") Z ")
        };
        let deadline = Instant::now() + Duration::from_secs(20);
        while !gone() {
            assert!(Instant::now() < deadline, "process {pid} is left");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

#[test]
fn a_limit_that_is_interrupted_kills_its_command() {
    let folder = tempfile::tempdir().unwrap();
    let begun = folder.path().join("begun");
    let within = concat!(env!("CARGO_MANIFEST_DIR"), "/within");
    let script = format!(
        "echo $$ >{}.part; mv {0}.part {0}; sleep 600",
        begun.display()
    );
    let mut child = Command::new(within)
        .args(["600", "bash", "-c", &script])
        .spawn()
        .unwrap();
    let deadline = Instant::now() + Duration::from_secs(20);
    while !begun.exists() {
        assert!(Instant::now() < deadline, "the command has not begun");
        std::thread::sleep(Duration::from_millis(20));
    }
    let pid = fs::read_to_string(&begun).unwrap();
    let mut signal = Command::new("kill");
    signal.args(["-TERM", &child.id().to_string()]);
    assert!(signal.status().unwrap().success());
    let status = child.wait().unwrap();
    assert_eq!((status.code(), status.signal()), (Some(143), None));
    let left = Path::new("/proc").join(pid.trim());
    assert!(!left.exists(), "process {pid} is left");
}

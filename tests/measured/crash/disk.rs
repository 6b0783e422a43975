//! Disks that fail.

use std::path::Path;
use std::process::Command;

use crate::crash::{KillCounts, Scenario};
use crate::support::needs;

/// libfiu's libraries, of the Debian package fiu-utils.
const FIU: &str = "/usr/lib/fiu";

/// One in fifty writes, or syncs, of files fails with EIO; sockets are left alone.
const FAULTS: [&str; 3] = [
    "enable_random name=posix/io/rw/pwrite*,probability=0.02,failinfo=5",
    "enable_random name=posix/io/sync/fsync,probability=0.02,failinfo=5",
    "enable_random name=posix/io/rw/pwrite*,probability=0.02,failinfo=5\n\
     enable_random name=posix/io/sync/fsync,probability=0.02,failinfo=5",
];

/// The most lives of a daemon in which a sync should fail: 2,000 syncs or more.
const MAX_LIVES: usize = 200;

/// Lets the disk of a daemon fail.
pub fn fail(command: &mut Command, faults: &str) {
    let preload = format!("{FIU}/fiu_run_preload.so {FIU}/fiu_posix_preload.so");
    command.env("LD_PRELOAD", preload).env("FIU_ENABLE", faults);
}

#[tokio::test(flavor = "multi_thread")]
async fn writes_and_syncs_that_fail_are_never_taken_for_done() {
    if !Path::new(FIU).exists() {
        needs::LIBFIU.is_missing();
        return;
    }
    let lives = if std::env::var_os("JOSTLE_LONG").is_some() {
        60
    } else {
        5
    };
    let mut total = KillCounts::default();
    for (seed, faults) in (1000..).zip(FAULTS) {
        let mut scenario = Scenario::begin(seed).await;
        scenario.faults = Some(faults.to_owned());
        let mut lived = 0;
        // A sync fails seldom, and ends the daemon: go on until one has.
        while lived < lives
            || faults == FAULTS[1] && scenario.counts.ended == 0 && lived < MAX_LIVES
        {
            scenario.run_until_killed().await;
            lived += 1;
        }
        scenario.faults = None;
        scenario.run_to_end().await;
        println!("{faults}: {:#?}", scenario.counts);
        total.add(&scenario.counts);
    }
    println!("{total:#?}");
    assert!(total.ended > 0, "no sync failed");
    assert!(total.rejected_as_full > 0, "no write failed");
}

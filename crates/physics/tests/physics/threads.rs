//! Results do not depend on the number of threads. Threads share the work of large groups, and the
//! order of every sum is independent of their number.

use std::sync::Arc;

use jostle_physics::model::threads::Pool;
use jostle_physics::model::{Attraction, Parameters, State, start};
use jostle_physics::stepper::Stepper;
use rayon::ThreadPoolBuilder;

use crate::{advance, with};

fn shared(threads: usize) -> Stepper {
    let pool = ThreadPoolBuilder::new().num_threads(threads).build();
    Stepper::with_pool(Pool::new(Arc::new(pool.unwrap())))
}

/// Asserts that the state hash after `steps` steps is the same without a pool and with pools of 1,
/// 2 and 4 threads. The `n` individuals are drawn in a disc of radius `radius * sqrt(n)`.
fn compare_threads(attraction: Attraction, n: usize, radius: f64, steps: u64) {
    let parameters = Parameters {
        attraction,
        ..Parameters::default()
    };
    let disc = start::disc(&parameters, n, Some(radius * (n as f64).sqrt()), 5).unwrap();
    let start = with(parameters, 5, disc);
    let run = |mut stepper: Stepper| -> State {
        let mut state = start.clone();
        advance(&mut stepper, &mut state, steps);
        state
    };
    let alone = run(Stepper::new());
    let pushing = alone.warm_start.contacts.len();
    assert!(10 * pushing > n, "only {pushing} contacts push at n = {n}");
    for threads in [1, 2, 4] {
        let hash = run(shared(threads)).hash();
        assert_eq!(hash, alone.hash(), "n = {n}, {threads} threads");
    }
}

#[test]
fn threads_change_no_bit_of_the_direct_sum_nor_of_contacts() {
    let direct = Attraction::All { accuracy: None };
    compare_threads(direct, 2000, 0.64, 200);
}

#[test]
fn threads_change_no_bit_of_the_tree_code() {
    let accuracy = Some(1e-6);
    compare_threads(Attraction::All { accuracy }, 20_000, 0.8, 10);
}

/// Set in the child process of the test below, in which no other test runs.
#[cfg(target_os = "linux")]
const ALONE: &str = "JOSTLE_TEST_WITHOUT_POOL";

#[cfg(target_os = "linux")]
#[expect(clippy::disallowed_types, reason = "a process of its own")]
#[test]
fn without_a_pool_no_thread_is_started() {
    if std::env::var_os(ALONE).is_none() {
        let child = std::process::Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "threads::without_a_pool_no_thread_is_started"])
            .env(ALONE, "1")
            .output()
            .unwrap();
        let output = String::from_utf8_lossy(&child.stdout);
        assert!(child.status.success(), "{output}");
        assert!(output.contains("1 passed"), "{output}");
        return;
    }
    let threads = || std::fs::read_dir("/proc/self/task").unwrap().count();
    let parameters = Parameters {
        attraction: Attraction::All {
            accuracy: Some(1e-6),
        },
        ..Parameters::default()
    };
    let disc = start::disc(&parameters, 20_000, Some(0.8 * 20_000_f64.sqrt()), 5).unwrap();
    let mut state = with(parameters, 5, disc);
    let before = threads();
    advance(&mut Stepper::new(), &mut state, 1);
    assert_eq!(threads(), before);
    // The count is one of all threads of the process.
    advance(&mut shared(3), &mut state, 1);
    assert!(threads() > before);
}

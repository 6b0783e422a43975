//! A process without a daemon that puts the state of a swarm as often as the daemon does, for
//! subscribers.

use std::io::Write;
use std::thread;
use std::time::{Duration, Instant};

use jostle_proto::{State, keys};
use jostled::auth::Rights;
use rustix::time::{ClockId, clock_gettime};
use zenoh::Wait;
use zenoh::qos::CongestionControl;

use crate::apart::open;

/// Listens as a daemon does, and prints its endpoint. Puts the present state of a daemon so often, each
/// time so many steps later, and for each line of its input prints the processor time used so far.
pub async fn publish(daemon: &str, swarm: &str, clients: usize, (hz, every): (f64, u64)) {
    let key = keys::state("jostle", swarm);
    let asking = open(daemon).await;
    let answers = asking.get(&key).await.unwrap();
    let state = answers.recv_async().await.unwrap().into_result().unwrap();
    let mut state = State::from_cbor(&state.payload().to_bytes()).unwrap();

    let listen = ["tcp/127.0.0.1:0".to_owned()];
    let session =
        jostled::transport::zenoh::session::open(&listen, "jostle", &Rights::Open, clients);
    let opened = session.await.unwrap();
    let session = &opened.session;
    let publisher = session
        .declare_publisher(key)
        .congestion_control(CongestionControl::Drop)
        .encoding("application/cbor");
    let publisher = publisher.await.unwrap();
    thread::spawn(move || {
        let mut next = Instant::now();
        loop {
            state.step += every;
            publisher.put(state.to_cbor()).wait().unwrap();
            next += Duration::from_secs_f64(1.0 / hz);
            thread::sleep(next.saturating_duration_since(Instant::now()));
        }
    });
    println!("listening on {}", session.info().locators().await[0]);
    for line in std::io::stdin().lines() {
        line.unwrap();
        println!("cpu {}", cpu_secs());
        std::io::stdout().flush().unwrap();
    }
}

fn cpu_secs() -> f64 {
    let cpu = clock_gettime(ClockId::ProcessCPUTime);
    cpu.tv_sec as f64 + 1e-9 * cpu.tv_nsec as f64
}

#![expect(clippy::unwrap_used, reason = "tests")]

use jostle_physics::simulation::{Simulation, Spec};

use super::*;
use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::frame::Stamp;
use crate::swarm::handle::{Handle, ReplyTo};
use crate::swarm::journal::NoWriter;
use crate::swarm::phase::Phase;
use crate::swarm::worker::Worker;

#[test]
fn a_full_lossless_queue_has_no_room_until_it_is_drained() {
    let handle = Handle::alone(Spec::new(6, 1));
    let start = Checkpoint::start(Simulation::new(&handle.spec).unwrap().checkpoint());
    let writer = (Arc::new(NoWriter) as _, Box::new(|_| Ok(())) as _);
    let ignored = &|_: &_| ReplyTo::ignored();
    let worker = Worker::restore(start, &handle, Duration::ZERO, writer, ignored);
    let (_, frame) = worker.stamp_and_frame();
    let output = Output::new("demo".to_owned());
    let woken = Arc::new(AtomicBool::new(false));
    let wakes = woken.clone();
    let subscription = output.subscribe(Limits {
        every: 1,
        steps: None,
        frames: 2,
        individuals: 100,
        overflow: Overflow::Block(Box::new(move || wakes.store(true, Ordering::Relaxed))),
    });
    for step in 0..2 {
        assert!(output.has_room());
        output.push_state((0, step), || frame.clone());
    }
    assert!(!output.has_room());
    assert!(!woken.load(Ordering::Relaxed));
    for _ in 0..2 {
        let item = subscription.next(Some(Instant::now()));
        assert!(matches!(item, Ok(Some(Item::Frame(..)))));
        assert!(woken.load(Ordering::Relaxed));
        assert!(output.has_room());
    }
}

#[test]
fn a_subscription_receives_every_state_and_event_until_it_is_dropped() {
    let output = Output::new("demo".to_owned());
    let push_event = |number| {
        let (phase, kind) = (Phase::Faulted("why".into()), EventKind::Created(None));
        let (epoch, step, time, seq) = (0, 0, 0.0, 0);
        output.push_event(&Event {
            number,
            stamp: Stamp {
                epoch,
                step,
                time,
                phase,
                seq,
            },
            unix_secs: None,
            kind,
        });
    };
    let state = |step| output.push_state((0, step), || unreachable!("an odd step is not copied"));
    push_event(1);
    let subscription = output.subscribe(Limits {
        every: 2,
        steps: Some(4),
        frames: 1,
        individuals: 1,
        overflow: Overflow::Block(Box::new(|| {})),
    });
    state(3);
    push_event(3);
    assert_eq!(subscription.steps_left(), Some(4));
    state(7);
    push_event(4);
    let next = || subscription.next(Some(Instant::now()));
    assert!(matches!(next(), Ok(Some(Item::Event(event, _))) if event.number == 3));
    assert!(matches!(next(), Err(End::Complete)));
    assert!(output.has_room(), "the swarm does not wait after the end");
    drop(subscription);
    push_event(5);
    assert!(output.subscriptions().is_empty());
    let (frames, events) = output.to_publish.take();
    assert!(frames.is_empty(), "the publisher receives published frames");
    let numbers: Vec<_> = events.iter().map(|event| event.number).collect();
    assert_eq!(numbers, [1, 3, 4, 5]);
}

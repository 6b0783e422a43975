//! Shares of the cores, with the processor time of real threads and of simulated ones.

#![expect(clippy::unwrap_used, reason = "tests")]

use std::fs::read_to_string;
use std::sync::mpsc::{Receiver, channel};
use std::thread;

use super::*;

fn share(scheduler: &Arc<CpuScheduler>) -> (Share, Receiver<()>) {
    share_of(scheduler, None)
}

fn share_of(scheduler: &Arc<CpuScheduler>, owner: Option<&str>) -> (Share, Receiver<()>) {
    let (call, called) = channel();
    let share = scheduler.share(owner, move || {
        let _ = call.send(());
    });
    (share, called)
}

#[test]
fn no_more_compute_than_there_are_turns_and_leaving_passes_one_on() {
    let scheduler = Arc::new(CpuScheduler::with_turns(2));
    let now = Instant::now();
    let [mut a, mut b, mut c, mut d] = [(); 4].map(|()| share(&scheduler));
    assert!(a.0.may_compute(now, Need::Behind) && b.0.may_compute(now, Need::Behind));
    assert!(!c.0.may_compute(now, Need::Behind) && !d.0.may_compute(now, Need::Behind));
    assert!(a.0.may_compute(now, Need::Behind), "its turn has not ended");
    a.0.leave();
    c.1.try_recv().unwrap();
    assert!(c.0.may_compute(now, Need::Behind) && !d.0.may_compute(now, Need::Behind));
    drop(b);
    assert!(d.0.may_compute(now, Need::Behind));
    d.0.leave();
    c.0.leave();
    assert!(a.0.may_compute(now, Need::Behind), "turns are free again");
    assert!(d.1.try_recv().is_ok() && d.1.try_recv().is_err());
}

#[test]
fn leaving_after_a_call_passes_the_turn_on() {
    let scheduler = Arc::new(CpuScheduler::with_turns(1));
    let now = Instant::now();
    let [mut a, mut b, mut c] = [(); 3].map(|()| share(&scheduler));
    assert!(
        a.0.may_compute(now, Need::Behind)
            && !b.0.may_compute(now, Need::Behind)
            && !c.0.may_compute(now, Need::Behind)
    );
    a.0.leave();
    b.0.leave();
    assert!(c.0.may_compute(now, Need::Behind), "called when b left");
    assert!(
        !b.0.may_compute(now, Need::Behind),
        "the earlier call is void"
    );
    b.0.leave();
    c.0.leave();
    assert!(b.0.may_compute(now, Need::Behind));
}

#[test]
fn a_turn_ends_if_others_wait() {
    let scheduler = Arc::new(CpuScheduler::with_turns(1));
    let now = Instant::now();
    let [mut a, mut b] = [(); 2].map(|()| share(&scheduler));
    assert!(a.0.may_compute(now, Need::Behind));
    assert!(
        a.0.may_compute(now + 2 * TURN, Need::Behind),
        "no swarm waits"
    );
    assert!(!b.0.may_compute(now + 2 * TURN, Need::Behind));
    assert!(
        a.0.may_compute(now + 5 * TURN / 2, Need::Behind),
        "its second turn"
    );
    let spent = Instant::now();
    while spent.elapsed() < TURN {}
    assert!(!a.0.may_compute(now + 4 * TURN, Need::Behind));
    assert!(b.0.may_compute(now + 4 * TURN, Need::Behind));
}

#[test]
fn a_swarm_that_keeps_its_rate_needs_no_turn_while_it_is_within_budget() {
    let scheduler = Arc::new(CpuScheduler::with_turns(1));
    let now = Instant::now();
    let [mut a, mut b, mut c] = [(); 3].map(|()| share(&scheduler));
    assert!(a.0.may_compute(now, Need::Behind));
    assert!(c.0.may_compute(now, Need::OnTime), "no swarm waits");
    b.0.virtual_time = 10 * TURN;
    assert!(!b.0.may_compute(now, Need::Behind));
    assert!(c.0.may_compute(now, Need::OnTime), "it has taken less");
    assert_eq!(c.0.virtual_time, 9 * TURN, "at most one turn less");
    c.0.virtual_time = 11 * TURN;
    assert!(!c.0.may_compute(now, Need::OnTime));
    a.0.leave();
    assert!(b.0.may_compute(now, Need::Behind) && !c.0.may_compute(now, Need::OnTime));
    b.0.leave();
    assert!(c.0.may_compute(now, Need::OnTime));
}

#[test]
fn time_taken_while_no_swarm_waited_is_not_charged() {
    let scheduler = Arc::new(CpuScheduler::with_turns(1));
    let now = Instant::now();
    let [mut a, mut b, mut c] = [(); 3].map(|()| share(&scheduler));
    assert!(a.0.may_compute(now, Need::Behind));
    a.0.virtual_time = 1000 * TURN;
    a.0.leave();
    assert!(b.0.may_compute(now, Need::Behind) && !a.0.may_compute(now, Need::Behind));
    assert!(!c.0.may_compute(now, Need::Behind));
    b.0.leave();
    assert!(a.0.may_compute(now, Need::Behind), "it asked before c");
}

/// A field of `/proc/thread-self/sched`, which only kernels with `SCHED_DEBUG` have.
fn field(name: &str) -> Option<u64> {
    let text = read_to_string("/proc/thread-self/sched").unwrap_or_default();
    let line = text.lines().find(|line| line.starts_with(name))?;
    line.rsplit(' ').next()?.parse().ok()
}

#[test]
fn a_thread_has_the_niceness_and_slice_that_it_asked_for() {
    let thread = thread::spawn(|| {
        lower_priority().unwrap();
        let niceness = rustix::process::getpriority_process(None).unwrap();
        (niceness, field("se.slice"))
    });
    let (niceness, slice) = thread.join().unwrap();
    assert_eq!(niceness, PACED_NICENESS);
    assert!(slice.is_none_or(|it| it == SLICE_NANOS), "{slice:?}");
}

const TICK: Duration = Duration::from_micros(100);

/// The weights that Linux gives threads of niceness 5 and 9.
const KERNEL_WEIGHTS: [f64; 2] = [335.0, 137.0];

/// A swarm that computes in a simulation: of whom, at which rate in steps a second or as fast as possible,
/// and the processor time of a step.
#[derive(Clone, Copy)]
struct Simulated(Option<&'static str>, Option<f64>, Duration);

/// A thread of a simulation.
struct Thread {
    share: Share,
    called: Receiver<()>,
    pace: Pace,
    is_paced: bool,
    step: Duration,
    cpu: Duration,
    steps: u32,
    /// What remains of the step that it computes.
    remains: Option<Duration>,
    is_queued: bool,
}

impl Thread {
    fn new(scheduler: &Arc<CpuScheduler>, it: Simulated, now: Instant) -> Self {
        let Simulated(owner, rate, step) = it;
        let (share, called) = share_of(scheduler, owner);
        Thread {
            share,
            called,
            pace: Pace::new(rate, 1.0, now),
            is_paced: rate.is_some(),
            step,
            cpu: Duration::ZERO,
            steps: 0,
            remains: None,
            is_queued: false,
        }
    }

    /// Computes for so long, then decides as the thread of a swarm does.
    fn tick(&mut self, computed: Duration, now: Instant) {
        self.cpu += computed;
        clock::simulate(Some(self.cpu));
        if let Some(remains) = &mut self.remains {
            *remains = remains.saturating_sub(computed);
            if !remains.is_zero() {
                return;
            }
            self.remains = None;
            self.steps += 1;
            self.pace.stepped(now);
        }
        if self.pace.until_due(now).is_some() {
            self.share.leave();
            self.is_queued = false;
        } else if (!self.is_queued || self.called.try_recv().is_ok())
            && self.share.may_compute(now, self.pace.need(now))
        {
            self.remains = Some(self.step);
            self.is_queued = false;
        } else {
            self.is_queued = true;
        }
    }
}

/// The threads of a scheduler on so many cores, with a kernel that divides them by weight.
struct Simulation {
    cores: f64,
    threads: Vec<Thread>,
    scheduler: Arc<CpuScheduler>,
    now: Instant,
}

impl Simulation {
    fn new(cores: u32, swarms: &[Simulated]) -> Self {
        let mut simulation = Simulation {
            cores: f64::from(cores),
            threads: Vec::new(),
            scheduler: Arc::new(CpuScheduler::new(cores as usize)),
            now: Instant::now(),
        };
        simulation.add(swarms);
        simulation
    }

    fn add(&mut self, swarms: &[Simulated]) {
        let new = swarms.iter();
        self.threads
            .extend(new.map(|it| Thread::new(&self.scheduler, *it, self.now)));
    }

    /// The processor time of each swarm in `seconds`, in cores, and the number of its steps.
    fn run(&mut self, seconds: f64) -> Vec<(f64, u32)> {
        let before: Vec<_> = self.threads.iter().map(|it| (it.cpu, it.steps)).collect();
        let end = self.now + Duration::from_secs_f64(seconds);
        while self.now < end {
            self.now += TICK;
            let parts = self.parts();
            for (thread, part) in self.threads.iter_mut().zip(parts) {
                thread.tick(TICK.mul_f64(part), self.now);
            }
        }
        clock::simulate(None);
        let threads = self.threads.iter().zip(before);
        threads
            .map(|(it, (cpu, steps))| ((it.cpu - cpu).as_secs_f64() / seconds, it.steps - steps))
            .collect()
    }

    /// The part of a core that each thread gets: at most one.
    fn parts(&self) -> Vec<f64> {
        let weight = |it: &Thread| match (it.remains, it.is_paced) {
            (None, _) => 0.0,
            (Some(_), true) => KERNEL_WEIGHTS[0],
            (Some(_), false) => KERNEL_WEIGHTS[1],
        };
        let mut weights: Vec<f64> = self.threads.iter().map(weight).collect();
        let mut parts = vec![0.0; weights.len()];
        let mut cores = self.cores;
        loop {
            let all: f64 = weights.iter().sum();
            let full = weights.iter().position(|it| *it > 0.0 && cores * it >= all);
            let Some(full) = full else {
                for (part, weight) in parts.iter_mut().zip(&weights) {
                    if *weight > 0.0 {
                        *part = cores * weight / all;
                    }
                }
                return parts;
            };
            parts[full] = 1.0;
            weights[full] = 0.0;
            cores -= 1.0;
        }
    }
}

const STEP: Duration = Duration::from_micros(300);

/// Swarms of a user without a rate.
fn unpaced(owner: &'static str, count: usize) -> Vec<Simulated> {
    vec![Simulated(Some(owner), None, STEP); count]
}

/// The cores that each user takes, in the order of `owners`.
fn cores_of(owners: &[&str], swarms: &[Simulated], cores: u32) -> Vec<f64> {
    let taken = Simulation::new(cores, swarms).run(1.0);
    let of = |owner: &&str| {
        let swarms = swarms.iter().zip(&taken);
        let own = swarms.filter(|(it, _)| it.0 == Some(*owner));
        own.map(|(_, (cores, _))| cores).sum()
    };
    owners.iter().map(of).collect()
}

fn assert_near(actual: &[f64], expected: &[f64], tolerance: f64) {
    let near = |(a, b): (&f64, &f64)| (a - b).abs() <= tolerance;
    assert_eq!(actual.len(), expected.len());
    assert!(
        actual.iter().zip(expected).all(near),
        "{actual:?} instead of {expected:?}"
    );
}

#[test]
fn users_have_equal_shares_whatever_the_number_of_their_swarms() {
    for (cores, counts) in [
        (1, &[1, 4][..]),
        (2, &[1, 4]),
        (2, &[2, 9]),
        (3, &[4, 4]),
        (4, &[4, 12]),
        (2, &[1, 2, 6]),
        (2, &[5, 1, 1, 1, 1, 3]),
        (4, &[2, 3, 4, 20]),
    ] {
        let owners = &["a", "b", "c", "d", "e", "f"][..counts.len()];
        let swarms = owners.iter().zip(counts);
        let swarms: Vec<_> = swarms.flat_map(|(it, count)| unpaced(it, *count)).collect();
        let each = f64::from(cores) / counts.len() as f64;
        let taken = cores_of(owners, &swarms, cores);
        assert_near(&taken, &vec![each; counts.len()], 0.05 * each);
    }
}

#[test]
fn the_swarms_of_one_user_have_equal_shares_of_what_the_user_has() {
    let swarms = [unpaced("a", 1), unpaced("b", 4)].concat();
    let taken = Simulation::new(2, &swarms).run(1.0);
    let taken: Vec<f64> = taken.into_iter().map(|it| it.0).collect();
    assert_near(&taken, &[1.0, 0.25, 0.25, 0.25, 0.25], 0.02);
    // Nobody is one user.
    let nobody = vec![Simulated(None, None, STEP); 3];
    let taken = Simulation::new(2, &[unpaced("a", 1), nobody].concat()).run(1.0);
    let taken: Vec<f64> = taken.into_iter().map(|it| it.0).collect();
    assert_near(&taken, &[1.0, 0.333, 0.333, 0.333], 0.02);
}

#[test]
fn without_users_shares_are_equal_by_swarm() {
    let taken = Simulation::new(2, &[Simulated(None, None, STEP); 5]).run(1.0);
    let taken: Vec<f64> = taken.into_iter().map(|it| it.0).collect();
    assert_near(&taken, &[0.4; 5], 0.01);
}

/// Time of two swarms in cores, one behind a rate that it cannot reach, and one without a rate, that
/// compute one at a time.
fn with_and_without_a_rate(step: Duration) -> Vec<f64> {
    let mut simulation = Simulation {
        scheduler: Arc::new(CpuScheduler::with_turns(1)),
        ..Simulation::new(1, &[])
    };
    simulation.add(&[
        Simulated(None, Some(1e6), step),
        Simulated(None, None, step),
    ]);
    // It falls behind in this time.
    simulation.run(0.2);
    let taken = simulation.run(2.0);
    taken.into_iter().map(|it| it.0).collect()
}

#[test]
fn a_swarm_behind_its_rate_comes_before_one_without_a_rate() {
    for step in [TURN / 3, TURN, 5 * TURN] {
        let taken = with_and_without_a_rate(step);
        // 16 turns of 17.
        assert_near(&taken, &[16.0 / 17.0, 1.0 / 17.0], 0.02);
    }
}

#[test]
fn shares_are_equal_however_long_a_step_is() {
    let swarms = [1, 3, 30].map(|length| Simulated(None, None, length * TURN / 3));
    let taken = Simulation::new(1, &swarms).run(2.0);
    let taken: Vec<f64> = taken.into_iter().map(|it| it.0).collect();
    assert_near(&taken, &[0.333; 3], 0.01);
}

#[test]
fn a_user_whose_swarms_cannot_use_their_share_leaves_it_to_others() {
    let swarms = [unpaced("a", 1), unpaced("b", 8)].concat();
    assert_near(&cores_of(&["a", "b"], &swarms, 4), &[1.0, 3.0], 0.1);
    let mut swarms = unpaced("b", 8);
    swarms.push(Simulated(Some("a"), Some(100.0), Duration::from_millis(1)));
    assert_near(&cores_of(&["a", "b"], &swarms, 2), &[0.1, 1.9], 0.05);
}

#[test]
fn shares_of_users_are_equal_however_long_a_step_is() {
    let long = Simulated(Some("a"), None, Duration::from_millis(30));
    let short = Simulated(Some("b"), None, Duration::from_micros(100));
    for (cores, each) in [(1, 0.5), (2, 1.0), (3, 1.5)] {
        let swarms = [[long; 4], [short; 4]].concat();
        let taken = cores_of(&["a", "b"], &swarms, cores);
        assert_near(&taken, &[each; 2], 0.12 * each);
    }
}

#[test]
fn a_user_gains_nothing_by_time_without_swarms_or_without_need() {
    // One core of four for a, until a has more swarms.
    let mut simulation = Simulation::new(4, &[unpaced("a", 1), unpaced("b", 8)].concat());
    simulation.run(1.0);
    simulation.add(&unpaced("a", 7));
    let taken = simulation.run(0.2);
    let of_b: f64 = taken[1..9].iter().map(|it| it.0).sum();
    assert_near(&[of_b], &[2.0], 0.1);
    simulation.add(&unpaced("c", 8));
    let taken = simulation.run(1.0);
    let of_c: f64 = taken[16..].iter().map(|it| it.0).sum();
    assert_near(&[of_c], &[4.0 / 3.0], 0.1);
}

/// Half a core, as the swarm of 500 at rate 5 of `overload::a_swarm_keeps_its_rate`.
const PACED: Simulated = Simulated(Some("a"), Some(250.0), Duration::from_millis(2));

#[test]
fn a_swarm_that_fits_keeps_its_rate_beside_swarms_of_others() {
    for others in [
        unpaced("b", 10),
        [unpaced("b", 10), unpaced("c", 10)].concat(),
        // Rates that no core reaches.
        vec![Simulated(Some("b"), Some(1e6), STEP); 10],
        // Of one user, too.
        unpaced("a", 10),
    ] {
        let swarms = [vec![PACED], others].concat();
        let mut simulation = Simulation::new(2, &swarms);
        simulation.run(0.2);
        let taken = simulation.run(1.0);
        assert!(taken[0].1 >= 245, "{taken:?}");
        let others = &taken[1..];
        assert!(others.iter().all(|it| it.0 > 0.03), "{taken:?}");
    }
}

#[test]
fn a_rate_that_cannot_be_reached_takes_no_more_than_the_share_of_its_user() {
    let swarms = [
        unpaced("a", 1),
        vec![Simulated(Some("b"), Some(1e6), STEP); 4],
    ]
    .concat();
    assert_near(&cores_of(&["a", "b"], &swarms, 2), &[1.0, 1.0], 0.05);
}

#[test]
fn rates_give_a_user_no_more_than_its_share() {
    // They need one and a half of two cores.
    let paced = vec![PACED; 3];
    let unreached = vec![Simulated(Some("b"), Some(1e6), STEP)];
    for others in [unpaced("b", 6), unpaced("b", 1), unreached.clone()] {
        let swarms = [paced.clone(), others].concat();
        assert_near(&cores_of(&["a", "b"], &swarms, 2), &[1.0, 1.0], 0.1);
    }
    // The kernel prefers the threads of swarms with a rate.
    for cores in [1, 2] {
        let swarms = [unpaced("a", 2), unreached.clone(), unpaced("c", 3)].concat();
        let each = f64::from(cores) / 3.0;
        assert_near(
            &cores_of(&["a", "b", "c"], &swarms, cores),
            &[each; 3],
            0.1 * each,
        );
    }
}

//! Random protocols, compared with the same commands sent to a simulation.

use jostle_physics::model::selection::Selection;
use jostle_physics::simulation::{Change, Placement, Settings, steps_in};

use super::{ByHand, finished, noise};
use crate::plan::Plan;

/// A source of numbers for the random protocols.
struct Numbers(blake3::OutputReader);

impl Numbers {
    fn below(&mut self, limit: u64) -> u64 {
        let mut bytes = [0; 8];
        self.0.fill(&mut bytes);
        u64::from_le_bytes(bytes) % limit
    }

    fn within(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * self.below(1000) as f64 / 1000.0
    }
}

/// What one block of a random protocol does, in the words of the test.
enum When {
    Step(u64),
    /// At the first step at which the order has been above a limit for a number of steps.
    Ordered(f64, u64),
}

/// Returns a random command as text and as a change.
fn command(numbers: &mut Numbers) -> (String, Change) {
    let angle = numbers.within(-3.0, 3.0);
    match numbers.below(7) {
        0 => {
            let fraction = numbers.within(0.0, 0.5);
            let text = format!(
                "inform = {{ select = {{ fraction = {fraction} }}, direction = {angle}, weight = 0.4 }}"
            );
            let change = Change::Inform {
                selection: Selection::Fraction(fraction),
                direction: angle,
                weight: Some(0.4),
                for_time: None,
            };
            (text, change)
        }
        1 => {
            let text = format!(
                "inform = {{ select = {{ foremost = {{ count = 3, along = {angle} }} }}, direction = \
                 {angle}, for_time = 1.5 }}"
            );
            let change = Change::Inform {
                selection: Selection::Foremost {
                    count: 3,
                    along: angle,
                },
                direction: angle,
                weight: None,
                for_time: Some(1.5),
            };
            (text, change)
        }
        2 => (
            "uninform = { select = { informed = true } }".to_owned(),
            Change::Uninform(Selection::Informed(true)),
        ),
        3 => {
            let count = 1 + numbers.below(4);
            let place = Placement::Border(usize::try_from(count).unwrap());
            let change = Change::Inject {
                place,
                informed: Some((angle, None)),
            };
            (
                format!("inject = {{ count = {count}, direction = {angle} }}"),
                change,
            )
        }
        4 => (
            "remove = { select = { count = 1 } }".to_owned(),
            Change::Remove(Selection::Count(1)),
        ),
        5 => {
            let pi1 = numbers.within(1.0, 4.0);
            let change = Change::Set(Settings {
                pi1: Some(pi1),
                make_room: true,
                ..Settings::default()
            });
            (format!("set = {{ pi1 = {pi1}, make_room = true }}"), change)
        }
        _ => {
            let value = numbers.within(0.0, 0.3);
            (format!("set = {{ noise = {value} }}"), noise(value))
        }
    }
}

#[test]
fn a_hundred_random_protocols_are_the_commands_of_a_swarm() {
    let (mut fired, mut faults) = (0, 0);
    for seed in 0..100u64 {
        let mut numbers = Numbers(
            blake3::Hasher::new()
                .update(&seed.to_le_bytes())
                .finalize_xof(),
        );
        let n = 10 + numbers.below(if seed % 10 == 0 { 191 } else { 40 });
        let steps = 60;
        let dt = 0.1;
        let mut text = format!(
            "name = \"a\"\nseed = {seed}\nduration = {}\nspec = {{ n = {n}, dt = {dt} }}\n",
            f64::from(steps) * dt
        );
        let mut blocks: Vec<(When, Vec<Change>)> = Vec::new();
        for _ in 0..22 {
            let (command, change) = command(&mut numbers);
            let when = match numbers.below(5) {
                0 => {
                    let limit = numbers.within(0.0, 0.6);
                    let lasting = numbers.below(12);
                    let lasting_text = match lasting {
                        0 => String::new(),
                        _ => format!(" for {}", lasting as f64 * dt),
                    };
                    text +=
                        &format!("[[at]]\nwhen = \"order > {limit}{lasting_text}\"\n{command}\n");
                    When::Ordered(limit, lasting)
                }
                1 => {
                    let step = numbers.below(60);
                    text += &format!("[[at]]\nstep = {step}\n{command}\n");
                    When::Step(step)
                }
                _ => {
                    let time = numbers.within(0.0, 5.9);
                    text += &format!("[[at]]\ntime = {time}\n{command}\n");
                    When::Step(steps_in(time, dt))
                }
            };
            blocks.push((when, vec![change]));
        }
        // A ramp in four steps of whole numbers of dt.
        text += "[[at]]\nfrom = 1\nuntil = 5\nevery = 1\nset = { pi3 = { ramp = [1, 2] } }\n";
        let ramp = |step: u64| {
            let pi3 = 1.0 + (step as f64 / 10.0 - 1.0) / 4.0;
            Change::Set(Settings {
                pi3: Some(pi3),
                ..Settings::default()
            })
        };
        let plan = Plan::parse(&text).unwrap_or_else(|error| panic!("{error}\n{text}"));
        let finished = finished(&plan, 0);

        let mut by_hand = ByHand::new(&plan, &plan.runs()[0]);
        let (mut above, mut is_done) = (vec![0u64; blocks.len()], vec![false; blocks.len()]);
        let mut rejected = None;
        'run: for step in 0..u64::try_from(steps).unwrap() {
            let order = by_hand.simulation.order().order;
            let mut due = Vec::new();
            for (index, (when, _)) in blocks.iter().enumerate() {
                if let When::Ordered(limit, lasting) = when {
                    above[index] = if order > *limit { above[index] + 1 } else { 0 };
                    if !is_done[index] && above[index] > *lasting {
                        is_done[index] = true;
                        fired += 1;
                        due.push(index);
                    }
                }
            }
            let at_step = |(_, (when, _)): &(usize, &(When, Vec<Change>))| matches!(when, When::Step(at) if *at == step);
            due.extend(
                blocks
                    .iter()
                    .enumerate()
                    .filter(at_step)
                    .map(|(index, _)| index),
            );
            let mut changes: Vec<Change> =
                due.iter().flat_map(|&at| blocks[at].1.clone()).collect();
            if (10..=50).contains(&step) && step.is_multiple_of(10) {
                changes.push(ramp(step));
            }
            for change in changes {
                let seq = by_hand.next_draw;
                if let Err(error) = by_hand.simulation.apply_at(seq, &change) {
                    rejected = Some(error.to_string());
                    break 'run;
                }
                by_hand.next_draw += 1;
            }
            by_hand.simulation.step().unwrap();
        }
        // A rejected command ends the run where the swarm rejects it.
        match (&finished.fault, &rejected) {
            (None, None) => {}
            (Some(fault), Some(error)) => {
                assert!(fault.contains(error), "{fault}: {error}");
                faults += 1;
            }
            other => panic!("seed {seed}: {other:?}"),
        }
        if let Some(row) = finished.row {
            assert_eq!(row.state_hash, by_hand.hash(), "seed {seed}");
        }
    }
    assert!(
        fired > 100 && faults < 10,
        "{fired} conditions fired, {faults} runs ended early"
    );
}

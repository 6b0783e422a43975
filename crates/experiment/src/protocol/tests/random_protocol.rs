//! Random protocols: the file of an experiment, and its commands as changes.

use jostle_physics::model::selection::Selection;
use jostle_physics::simulation::{Change, Placement, Settings, steps_in};

/// The time step, and the number of steps of a run.
pub const DT: f64 = 0.1;
pub const STEPS: u64 = 60;

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
pub enum When {
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
            let place = Placement::Border(usize::try_from(count).expect("at most 4"));
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
            let change = Change::Set(Settings {
                noise: Some(value),
                ..Settings::default()
            });
            (format!("set = {{ noise = {value} }}"), change)
        }
    }
}

/// Returns the file of a random protocol, and its blocks but for the last one: a ramp of `pi3` from 1 to 2,
/// from step 10 to step 50, every 10 steps.
pub fn random_protocol(seed: u64) -> (String, Vec<(When, Vec<Change>)>) {
    let mut numbers = Numbers(
        blake3::Hasher::new()
            .update(&seed.to_le_bytes())
            .finalize_xof(),
    );
    let n = 10 + numbers.below(if seed.is_multiple_of(10) { 191 } else { 40 });
    let mut text = format!(
        "name = \"a\"\nseed = {seed}\nduration = {}\nspec = {{ n = {n}, dt = {DT} }}\n",
        STEPS as f64 * DT
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
                    _ => format!(" for {}", lasting as f64 * DT),
                };
                text += &format!("[[at]]\nwhen = \"order > {limit}{lasting_text}\"\n{command}\n");
                When::Ordered(limit, lasting)
            }
            1 => {
                let step = numbers.below(STEPS);
                text += &format!("[[at]]\nstep = {step}\n{command}\n");
                When::Step(step)
            }
            _ => {
                let time = numbers.within(0.0, 5.9);
                text += &format!("[[at]]\ntime = {time}\n{command}\n");
                When::Step(steps_in(time, DT))
            }
        };
        blocks.push((when, vec![change]));
    }
    // A ramp in four steps of whole numbers of dt.
    text += "[[at]]\nfrom = 1\nuntil = 5\nevery = 1\nset = { pi3 = { ramp = [1, 2] } }\n";
    (text, blocks)
}

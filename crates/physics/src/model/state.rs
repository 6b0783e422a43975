//! The state of a swarm, which determines its future, and the hash that identifies a state.

use std::io::{BufWriter, Write};

use super::{Attraction, Configuration, ContactRule, Drive, Parameters, Stepping};

/// Version of the model. It changes whenever the same state would have another future.
pub const MODEL_VERSION: u32 = 2;

/// The oldest version whose states this program reads. Its states go on under [`MODEL_VERSION`].
pub const OLDEST_MODEL_VERSION: u32 = 1;

/// A contact that pushed in the last step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WarmContact {
    /// Id of the pair's first individual.
    pub first: u32,
    /// Id of the pair's second individual, larger than the first.
    pub second: u32,
    /// Code of the contact: which ends touch.
    pub code: u8,
    /// Multiplier of the contact in the last step.
    pub multiplier: f64,
}

/// Data that the solver carries from one step to the next.
///
/// The contacts are the next step's guess of the active set, and the order is the elimination
/// order of its factorisation. Both affect the last bits of a step, so they belong to the state.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WarmStart {
    /// The contacts with a positive multiplier, ordered by (first, second, code).
    pub contacts: Vec<WarmContact>,
    /// The elimination order of individuals, by index; empty until a step first needs it.
    pub order: Vec<u32>,
    /// Number of programs that were solved in this order.
    pub order_age: u32,
}

/// A swarm at one step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct State {
    /// Parameters of the motion.
    pub parameters: Parameters,
    /// Seed of all random draws.
    pub seed: u64,
    /// Number of steps taken.
    pub step: u64,
    /// All individuals.
    pub configuration: Configuration,
    /// The solver's data from the last step.
    pub warm_start: WarmStart,
}

impl State {
    /// Returns the time `step dt`, in body sizes over the free speed.
    #[must_use]
    pub fn time(&self) -> f64 {
        self.step as f64 * self.parameters.dt
    }

    /// Hashes everything on which steps depend: two states with the same hash take the same steps
    /// on x86-64, aarch64 and wasm32 with any number of threads, in programs of one version.
    ///
    /// The hash is BLAKE3 over little-endian bytes in this order: model version; `pi1, pi2, pi3,
    /// pi4, dt`, rules, attraction law; seed; step; origin; next id; the columns id, x, y, alpha,
    /// weight, direction, lapses; drives; the warm start as columns first, second, code,
    /// multiplier, then the elimination order, a column, and its age.
    ///
    /// - A column is its length as 64 bits, then its entries. An entry of "lapses" is a byte 0,
    ///   or a byte 1 and the step.
    /// - The rules are a byte. From the lowest on, its bits are `closest`, `velocity`,
    ///   `relinearise`, noise, `clamped`, and whether any individual is driven directly. If there
    ///   is noise, its intensity follows the byte.
    /// - The attraction law is a byte and its number, if it has one: 0 `all`, 1 `all` with its
    ///   accuracy, 2 `voronoi`, 3 `metric` with its radius, 4 `topological` with its number of
    ///   neighbours as a float, 5 `power` with its exponent.
    /// - The drives, without a length, are for each driven individual its id, then a byte and a
    ///   number for the turning rate and the same for the speed.
    /// - Floats are hashed by their bits.
    #[must_use]
    pub fn hash(&self) -> [u8; 32] {
        self.hash_under(MODEL_VERSION)
    }

    /// Returns the hash that a program of this version of the model, from [`OLDEST_MODEL_VERSION`] on,
    /// gives the state.
    #[must_use]
    pub fn hash_under(&self, model_version: u32) -> [u8; 32] {
        let Self {
            parameters,
            seed,
            step,
            configuration,
            warm_start,
        } = self;
        let mut bytes = Bytes::new();
        bytes.put(model_version.to_le_bytes());
        let Parameters {
            pi1,
            pi2,
            pi3,
            pi4,
            dt,
            contacts,
            stepping,
            relinearise,
            attraction,
            noise,
        } = parameters;
        [pi1, pi2, pi3, pi4, dt]
            .into_iter()
            .for_each(|value| bytes.put(value.to_le_bytes()));
        // Each setting that differs from its default sets a bit.
        let is_noisy = *noise != 0.0;
        let rules = [
            *contacts == ContactRule::Closest,
            *stepping == Stepping::Velocity,
            *relinearise,
            is_noisy,
            *contacts == ContactRule::Clamped,
            !configuration.drives.is_empty(),
        ];
        let rules = rules.iter().rev();
        bytes.put([rules.fold(0, |bits, &is_set| bits << 1 | u8::from(is_set))]);
        if is_noisy {
            bytes.put(noise.to_le_bytes());
        }
        let (law, number) = match *attraction {
            Attraction::All { accuracy } => (u8::from(accuracy.is_some()), accuracy),
            Attraction::Voronoi => (2, None),
            Attraction::Metric { radius } => (3, Some(radius)),
            Attraction::Topological { neighbours } => (4, Some(f64::from(neighbours))),
            Attraction::Power { exponent } => (5, Some(exponent)),
        };
        bytes.put([law]);
        if let Some(number) = number {
            bytes.put(number.to_le_bytes());
        }
        bytes.put(seed.to_le_bytes());
        bytes.put(step.to_le_bytes());
        let Configuration {
            origin,
            next_id,
            id,
            x,
            y,
            alpha,
            weight,
            direction,
            lapses_at,
            drives,
        } = configuration;
        origin.iter().for_each(|cell| bytes.put(cell.to_le_bytes()));
        bytes.put(next_id.to_le_bytes());
        bytes.column(id.iter().map(|id| id.to_le_bytes()));
        for column in [x, y, alpha, weight, direction] {
            bytes.column(column.iter().map(|value| value.to_le_bytes()));
        }
        bytes.put((lapses_at.len() as u64).to_le_bytes());
        for lapse in lapses_at {
            bytes.put([u8::from(lapse.is_some())]);
            if let Some(step) = lapse {
                bytes.put(step.to_le_bytes());
            }
        }
        for (id, Drive { turn, speed }) in drives {
            bytes.put(id.to_le_bytes());
            for value in [turn, speed] {
                bytes.put([u8::from(value.is_some())]);
                bytes.put(value.unwrap_or_default().to_le_bytes());
            }
        }
        let WarmStart {
            contacts,
            order,
            order_age,
        } = warm_start;
        bytes.column(contacts.iter().map(|contact| contact.first.to_le_bytes()));
        bytes.column(contacts.iter().map(|contact| contact.second.to_le_bytes()));
        bytes.column(contacts.iter().map(|contact| [contact.code]));
        bytes.column(
            contacts
                .iter()
                .map(|contact| contact.multiplier.to_le_bytes()),
        );
        bytes.column(order.iter().map(|index| index.to_le_bytes()));
        bytes.put(order_age.to_le_bytes());
        bytes.hash()
    }
}

/// Bytes to be hashed. They are collected in a buffer: hashing one number at a time takes five
/// times as long.
struct Bytes(BufWriter<blake3::Hasher>);

impl Bytes {
    /// Size of the buffer.
    const CAPACITY: usize = 16 * 1024;

    fn new() -> Self {
        Self(BufWriter::with_capacity(
            Self::CAPACITY,
            blake3::Hasher::new(),
        ))
    }

    fn put<const N: usize>(&mut self, bytes: [u8; N]) {
        self.0.write_all(&bytes).expect("hashing does not fail");
    }

    fn hash(self) -> [u8; 32] {
        let hasher = self.0.into_inner().expect("hashing does not fail");
        *hasher.finalize().as_bytes()
    }

    fn column<const N: usize>(&mut self, entries: impl ExactSizeIterator<Item = [u8; N]>) {
        self.put((entries.len() as u64).to_le_bytes());
        entries.for_each(|entry| self.put(entry));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> State {
        let mut configuration = Configuration {
            origin: [3, -4],
            ..Configuration::default()
        };
        configuration.push(1.0, 2.0, 3.0);
        configuration.push(4.0, 5.0, 6.0);
        configuration.inform(1, 0.5, 1.5, Some(77));
        let contacts = vec![WarmContact {
            first: 0,
            second: 1,
            code: 4,
            multiplier: 0.25,
        }];
        let warm_start = WarmStart {
            contacts,
            order: vec![1, 0],
            order_age: 6,
        };
        State {
            seed: 8,
            step: 9,
            configuration,
            warm_start,
            ..State::default()
        }
    }

    fn accurate(accuracy: f64) -> Attraction {
        Attraction::All {
            accuracy: Some(accuracy),
        }
    }

    /// A change of any of these bytes requires a new model version.
    #[test]
    fn the_layout_does_not_change() {
        let state = example();
        let mut bytes: Vec<u8> = Vec::new();
        bytes.extend(2u32.to_le_bytes());
        bytes.extend([4.0, 0.5, 1.0, 10.0, 0.02].map(f64::to_le_bytes).concat());
        bytes.extend([0, 0]);
        bytes.extend([8u64, 9].map(u64::to_le_bytes).concat());
        bytes.extend([3i64, -4].map(i64::to_le_bytes).concat());
        bytes.extend(2u32.to_le_bytes());
        bytes.extend(2u64.to_le_bytes());
        bytes.extend([0u32, 1].map(u32::to_le_bytes).concat());
        for column in [[1.0, 4.0], [2.0, 5.0], [3.0, 6.0], [0.0, 0.5], [0.0, 1.5]] {
            bytes.extend(2u64.to_le_bytes());
            bytes.extend(column.map(f64::to_le_bytes).concat());
        }
        bytes.extend(2u64.to_le_bytes());
        bytes.extend([0, 1]);
        bytes.extend(77u64.to_le_bytes());
        bytes.extend([&1u64.to_le_bytes()[..], &0u32.to_le_bytes()].concat());
        bytes.extend([&1u64.to_le_bytes()[..], &1u32.to_le_bytes()].concat());
        bytes.extend([&1u64.to_le_bytes()[..], &[4]].concat());
        bytes.extend([&1u64.to_le_bytes()[..], &0.25f64.to_le_bytes()].concat());
        bytes.extend(2u64.to_le_bytes());
        bytes.extend([1u32, 0, 6].map(u32::to_le_bytes).concat());
        assert_eq!(state.hash(), *blake3::hash(&bytes).as_bytes());
        assert_eq!(state.time(), 9.0 * 0.02);
    }

    #[test]
    fn everything_that_decides_the_future_is_hashed() {
        let changes: [fn(&mut State); 39] = [
            |state| state.parameters.pi1 = 5.0,
            |state| state.parameters.pi2 = 5.0,
            |state| state.parameters.pi3 = 5.0,
            |state| state.parameters.pi4 = 5.0,
            |state| state.parameters.dt = 0.01,
            |state| state.parameters.attraction = accurate(1e-6),
            |state| state.parameters.attraction = accurate(1e-7),
            |state| state.parameters.attraction = Attraction::Voronoi,
            |state| state.parameters.attraction = Attraction::Metric { radius: 1.0 },
            |state| state.parameters.attraction = Attraction::Metric { radius: 2.0 },
            |state| state.parameters.attraction = Attraction::Topological { neighbours: 1 },
            |state| state.parameters.attraction = Attraction::Topological { neighbours: 2 },
            |state| state.parameters.attraction = Attraction::Power { exponent: 1.0 },
            |state| state.parameters.contacts = ContactRule::Closest,
            |state| state.parameters.contacts = ContactRule::Clamped,
            |state| state.parameters.stepping = Stepping::Velocity,
            |state| state.parameters.relinearise = true,
            |state| state.parameters.noise = 0.1,
            |state| state.parameters.noise = 0.2,
            |state| state.seed += 1,
            |state| state.step += 1,
            |state| state.configuration.origin[1] += 1,
            |state| state.configuration.next_id += 1,
            |state| state.configuration.id[1] += 1,
            |state| state.configuration.x[0] = -1.0,
            |state| state.configuration.y[0] = -1.0,
            |state| state.configuration.alpha[0] = -1.0,
            |state| state.configuration.weight[0] = -1.0,
            |state| state.configuration.direction[0] = -0.0,
            |state| state.configuration.lapses_at[0] = Some(0),
            |state| {
                state.configuration.drives.insert(0, Drive::default());
            },
            |state| {
                let turn = Some(0.0);
                let drive = Drive { turn, speed: None };
                state.configuration.drives.insert(0, drive);
            },
            |state| {
                let speed = Some(0.0);
                let drive = Drive { turn: None, speed };
                state.configuration.drives.insert(0, drive);
            },
            |state| state.warm_start.contacts[0].first = 9,
            |state| state.warm_start.contacts[0].second = 9,
            |state| state.warm_start.contacts[0].code = 9,
            |state| state.warm_start.contacts[0].multiplier = 9.0,
            |state| state.warm_start.order[0] = 9,
            |state| state.warm_start.order_age = 9,
        ];
        let mut hashes = vec![example().hash()];
        for (k, change) in changes.into_iter().enumerate() {
            let mut state = example();
            change(&mut state);
            assert!(!hashes.contains(&state.hash()), "change {k} is not hashed");
            hashes.push(state.hash());
        }
    }
}

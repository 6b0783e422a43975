//! Selection of the individuals that a command applies to.

use thiserror::Error;

use super::injection::check_radius;
use super::parameters::{check_coordinate, check_finite};
use super::random::{Purpose, Stream};
use super::{Configuration, ParametersError};
use crate::plural::counted;

/// A rule that selects individuals.
#[derive(Clone, Debug, PartialEq)]
pub enum Selection {
    /// The individuals with these ids.
    Ids(Vec<u32>),
    /// This number of individuals, drawn at random.
    Count(usize),
    /// This share, rounded to whole individuals, drawn at random.
    Fraction(f64),
    /// All individuals whose centre is in a disc, in absolute coordinates.
    Within {
        /// Centre.
        x: f64,
        /// Centre.
        y: f64,
        /// Radius.
        radius: f64,
    },
    /// All individuals with a preferred direction, or all without one.
    Informed(bool),
    /// The individuals that are furthest in a direction; ties go to the lower ids.
    Foremost {
        /// Number of individuals.
        count: usize,
        /// The direction, counter-clockwise from +x.
        along: f64,
    },
}

/// The individuals from which a selection is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Candidates {
    /// All individuals.
    All,
    /// The individuals with a preferred direction.
    Informed,
}

/// Why a selection is rejected.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum SelectionError {
    /// A number is outside its range.
    #[error(transparent)]
    Number(#[from] ParametersError),
    /// The number requested is larger than the number of candidates.
    #[error("{}", too_many(.field, *.count, *.candidates, *.among))]
    Count {
        /// The field's name.
        field: &'static str,
        /// The number requested.
        count: usize,
        /// Number of candidates.
        candidates: usize,
        /// Which individuals are candidates.
        among: Candidates,
    },
    /// No candidate has the id.
    #[error("select.ids: {}", unknown(*.id, *.candidates, *.among))]
    UnknownId {
        /// The id.
        id: u32,
        /// Number of candidates.
        candidates: usize,
        /// Which individuals are candidates.
        among: Candidates,
    },
    /// An id is given twice.
    #[error("select.ids: {id} is given twice")]
    RepeatedId {
        /// The id.
        id: u32,
    },
}

fn too_many(field: &str, count: usize, candidates: usize, among: Candidates) -> String {
    let individuals = counted(candidates, "individual");
    match (among, candidates) {
        (Candidates::All, _) => {
            format!("{field} = {count}, but the swarm has {individuals}: select fewer")
        }
        (Candidates::Informed, 0) => {
            format!(
                "{field} = {count}, but no individual is informed: there is nothing to uninform"
            )
        }
        (Candidates::Informed, _) => format!(
            "{field} = {count}, but only {individuals} {} informed: select fewer",
            if candidates == 1 { "is" } else { "are" }
        ),
    }
}

fn unknown(id: u32, candidates: usize, among: Candidates) -> String {
    match (among, candidates) {
        (Candidates::All, _) => format!("no individual has the id {id}"),
        (Candidates::Informed, 0) => {
            format!(
                "{id} is not informed, nor is any other individual: there is nothing to uninform"
            )
        }
        (Candidates::Informed, _) => format!("no informed individual has the id {id}"),
    }
}

impl Selection {
    /// Checks the numbers of a rule that no swarm accepts, whatever its individuals are.
    ///
    /// # Errors
    ///
    /// [`SelectionError::Number`] and [`SelectionError::RepeatedId`].
    pub fn check(&self) -> Result<(), SelectionError> {
        match *self {
            Selection::Count(_) | Selection::Informed(_) => {}
            Selection::Ids(ref ids) => {
                let mut sorted = ids.clone();
                sorted.sort_unstable();
                if let Some(pair) = sorted.windows(2).find(|pair| pair[0] == pair[1]) {
                    return Err(SelectionError::RepeatedId { id: pair[0] });
                }
            }
            Selection::Fraction(fraction) => share(0, fraction).map(drop)?,
            Selection::Within { x, y, radius } => {
                check_finite("select.within.x", x)?;
                check_finite("select.within.y", y)?;
                check_radius("select.within.radius", radius)?;
            }
            Selection::Foremost { along, .. } => check_coordinate("select.foremost.along", along)?,
        }
        Ok(())
    }
}

/// Selects individuals and returns their indices in ascending order.
///
/// Draws are keyed by the swarm's seed and the command's number `seq`.
///
/// # Errors
///
/// [`SelectionError`]; its message names the field and the value.
pub fn select(
    configuration: &Configuration,
    candidates: Candidates,
    selection: &Selection,
    seed: u64,
    seq: u64,
) -> Result<Vec<usize>, SelectionError> {
    selection.check()?;
    let mut pool: Vec<usize> = (0..configuration.n())
        .filter(|&k| candidates == Candidates::All || configuration.weight[k] > 0.0)
        .collect();
    let check_count = |field, count: usize| match count <= pool.len() {
        true => Ok(count),
        false => Err(SelectionError::Count {
            field,
            count,
            candidates: pool.len(),
            among: candidates,
        }),
    };
    match *selection {
        Selection::Ids(ref ids) => return by_id(configuration, &pool, ids, candidates),
        Selection::Count(count) => {
            let count = check_count("select.count", count)?;
            draw(&mut pool, count, seed, seq);
        }
        Selection::Fraction(fraction) => {
            let count = share(pool.len(), fraction)?;
            draw(&mut pool, count, seed, seq);
        }
        Selection::Within { x, y, radius } => {
            let centre = configuration.relative([x, y]);
            pool.retain(|&k| {
                let (dx, dy) = (
                    configuration.x[k] - centre[0],
                    configuration.y[k] - centre[1],
                );
                dx * dx + dy * dy <= radius * radius
            });
        }
        Selection::Informed(is_informed) => {
            pool.retain(|&k| (configuration.weight[k] > 0.0) == is_informed);
        }
        Selection::Foremost { count, along } => {
            let count = check_count("select.foremost.count", count)?;
            let (sin, cos) = libm::sincos(along);
            let lead = |k: usize| configuration.x[k] * cos + configuration.y[k] * sin;
            pool.sort_by(|&a, &b| lead(b).total_cmp(&lead(a)).then(a.cmp(&b)));
            pool.truncate(count);
        }
    }
    pool.sort_unstable();
    Ok(pool)
}

/// Finds the indices of `ids`, in ascending order: ids increase with the index.
fn by_id(
    configuration: &Configuration,
    pool: &[usize],
    ids: &[u32],
    among: Candidates,
) -> Result<Vec<usize>, SelectionError> {
    let mut sorted = ids.to_vec();
    sorted.sort_unstable();
    let find = |id: &u32| {
        pool.binary_search_by(|&k| configuration.id[k].cmp(id))
            .map(|place| pool[place])
            .map_err(|_| SelectionError::UnknownId {
                id: *id,
                candidates: pool.len(),
                among,
            })
    };
    sorted.iter().map(find).collect()
}

/// Returns a share of `candidates` rounded to whole individuals, halves upwards.
///
/// # Errors
///
/// [`SelectionError::Number`] for a fraction outside [0, 1].
pub fn share(candidates: usize, fraction: f64) -> Result<usize, SelectionError> {
    if !(0.0..=1.0).contains(&fraction) {
        let range = "[0, 1]: write 0.1 for 10 %";
        let (field, value) = ("select.fraction", fraction);
        return Err(ParametersError::OutOfRange {
            field,
            value,
            range,
        }
        .into());
    }
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "between 0 and the count"
    )]
    Ok(libm::round(fraction * candidates as f64) as usize)
}

/// Keeps `count` of `pool`, every subset with equal probability: the first `count` steps of a
/// shuffle.
fn draw(pool: &mut Vec<usize>, count: usize, seed: u64, seq: u64) {
    let mut stream = Stream::new(seed, seq, 0, Purpose::Selection);
    for k in 0..count {
        let left = (pool.len() - k) as u64;
        #[expect(clippy::cast_possible_truncation, reason = "below a length")]
        pool.swap(k, k + stream.below(left) as usize);
    }
    pool.truncate(count);
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    /// Ids 10 to 19 on a line, the even ones informed.
    fn line() -> Configuration {
        let mut configuration = Configuration {
            next_id: 10,
            ..Configuration::default()
        };
        for k in 0..10usize {
            configuration.push(k as f64, 0.0, 0.0);
            configuration.inform(k, if k % 2 == 0 { 0.5 } else { 0.0 }, 1.0, None);
        }
        configuration
    }

    #[expect(clippy::needless_pass_by_value, reason = "reads better at the calls")]
    fn pick(candidates: Candidates, selection: Selection) -> Result<Vec<usize>, SelectionError> {
        select(&line(), candidates, &selection, 1, 2)
    }

    #[test]
    fn ids_are_found_in_any_order_and_rejected_if_unknown_or_repeated() {
        let ids = |candidates, ids: &[u32]| pick(candidates, Selection::Ids(ids.to_vec()));
        assert_eq!(ids(Candidates::All, &[19, 10, 12]).unwrap(), [0, 2, 9]);
        assert!(ids(Candidates::All, &[]).unwrap().is_empty());
        assert_eq!(ids(Candidates::Informed, &[12]).unwrap(), [2]);
        assert_eq!(
            ids(Candidates::All, &[20]),
            Err(SelectionError::UnknownId {
                id: 20,
                candidates: 10,
                among: Candidates::All,
            })
        );
        assert_eq!(
            ids(Candidates::Informed, &[11]),
            Err(SelectionError::UnknownId {
                id: 11,
                candidates: 5,
                among: Candidates::Informed,
            })
        );
        assert_eq!(
            ids(Candidates::All, &[11, 10, 11]),
            Err(SelectionError::RepeatedId { id: 11 })
        );
    }

    #[test]
    fn draws_are_uniform_over_commands_and_fixed_for_one_command() {
        let mut counts = [0; 10];
        for seq in 0..2000 {
            let drawn = select(&line(), Candidates::All, &Selection::Count(3), 1, seq).unwrap();
            assert!(drawn.windows(2).all(|pair| pair[0] < pair[1]) && drawn.len() == 3);
            drawn.iter().for_each(|&k| counts[k] += 1);
        }
        // Each individual is drawn 600 times on average, with a standard deviation of 20.
        assert!(
            counts.iter().all(|count| (480..720).contains(count)),
            "{counts:?}"
        );
        let draw_five = || pick(Candidates::All, Selection::Count(5)).unwrap();
        assert_eq!(draw_five(), draw_five());
    }

    #[test]
    fn counts_and_fractions_stay_within_the_candidates() {
        assert_eq!(
            pick(Candidates::All, Selection::Count(10)).unwrap(),
            (0..10).collect::<Vec<_>>()
        );
        assert_eq!(
            pick(Candidates::Informed, Selection::Count(5)).unwrap(),
            [0, 2, 4, 6, 8]
        );
        assert!(
            pick(Candidates::All, Selection::Count(0))
                .unwrap()
                .is_empty()
        );
        let error = SelectionError::Count {
            field: "select.count",
            count: 6,
            candidates: 5,
            among: Candidates::Informed,
        };
        assert_eq!(
            error.to_string(),
            "select.count = 6, but only 5 individuals are informed: select fewer"
        );
        assert_eq!(pick(Candidates::Informed, Selection::Count(6)), Err(error));
        for (fraction, count) in [(0.0, 0), (0.04, 0), (0.05, 1), (0.5, 5), (1.0, 10)] {
            assert_eq!(
                pick(Candidates::All, Selection::Fraction(fraction))
                    .unwrap()
                    .len(),
                count
            );
        }
        for fraction in [-0.1, 1.1, f64::NAN, f64::INFINITY] {
            let error = pick(Candidates::All, Selection::Fraction(fraction)).unwrap_err();
            assert!(error.to_string().starts_with("select.fraction"), "{error}");
        }
    }

    #[test]
    fn the_error_of_a_selection_has_the_number_of_candidates() {
        let error = |candidates, among| {
            let field = "select.count";
            let count = SelectionError::Count {
                field,
                count: 3,
                candidates,
                among,
            };
            let id = SelectionError::UnknownId {
                id: 7,
                candidates,
                among,
            };
            (count.to_string(), id.to_string())
        };
        let (count, id) = error(0, Candidates::Informed);
        assert!(count.contains("no individual is informed"), "{count}");
        assert!(id.contains("7 is not informed"), "{id}");
        let (count, id) = error(1, Candidates::Informed);
        assert!(count.contains("only 1 individual is informed"), "{count}");
        assert!(id.contains("no informed individual has the id 7"), "{id}");
        let (count, id) = error(1, Candidates::All);
        assert!(count.contains("the swarm has 1 individual:"), "{count}");
        assert!(id.contains("no individual has the id 7"), "{id}");
    }

    #[test]
    fn a_disc_is_in_absolute_coordinates() {
        let mut configuration = line();
        configuration.origin = [1, 0];
        let within = |x, y, radius| {
            select(
                &configuration,
                Candidates::All,
                &Selection::Within { x, y, radius },
                1,
                2,
            )
        };
        assert_eq!(within(1024.0 + 4.0, 0.0, 1.0).unwrap(), [3, 4, 5]);
        assert!(within(4.0, 0.0, 1.0).unwrap().is_empty());
        // From (x, 3), the nearest is 3 away and its neighbours √10: the distance is Euclidean.
        assert!(within(1024.0 + 4.0, 3.0, 2.9).unwrap().is_empty());
        assert_eq!(within(1024.0 + 4.0, 3.0, 3.0).unwrap(), [4]);
        assert_eq!(within(1024.0 + 4.0, 3.0, 3.2).unwrap(), [3, 4, 5]);
        assert_eq!(within(1024.0 - 4.0, 0.0, 4.0).unwrap(), [0]);
        for (x, y, radius, field) in [
            (f64::NAN, 0.0, 1.0, "select.within.x"),
            (0.0, f64::INFINITY, 1.0, "select.within.y"),
            (0.0, 0.0, 0.0, "select.within.radius"),
            (0.0, 0.0, f64::NAN, "select.within.radius"),
        ] {
            assert!(
                within(x, y, radius)
                    .unwrap_err()
                    .to_string()
                    .starts_with(field)
            );
        }
    }

    #[test]
    fn the_foremost_lead_in_the_direction_and_ties_go_to_the_lower_id() {
        let foremost = |count, along| pick(Candidates::All, Selection::Foremost { count, along });
        assert_eq!(foremost(2, 0.0).unwrap(), [8, 9]);
        assert_eq!(foremost(2, std::f64::consts::PI).unwrap(), [0, 1]);
        let mut abreast = line();
        abreast.x = vec![0.0; 10];
        let selection = Selection::Foremost {
            count: 3,
            along: 0.7,
        };
        assert_eq!(
            select(&abreast, Candidates::All, &selection, 1, 2).unwrap(),
            [0, 1, 2]
        );
        assert!(
            foremost(1, f64::NAN)
                .unwrap_err()
                .to_string()
                .starts_with("select.foremost.along")
        );
        assert!(
            foremost(11, 0.0)
                .unwrap_err()
                .to_string()
                .starts_with("select.foremost.count")
        );
    }
}

//! Social attraction: where each individual wants to turn because of the others.

use super::{Attraction, Configuration};

/// How many partial sums run side by side. The lanes are explicit so that the compiler may use
/// vector registers without changing a sum's order, whatever the machine.
const LANES: usize = 8;

/// Computes `p_s` of every individual into `pull`.
///
/// - Shapes: n individuals in, n vectors out.
/// - Units: lengths at most 1. Alone, an individual is pulled nowhere; one at the same place
///   pulls nowhere but is counted.
/// - Source: paper, eq. (4).
pub fn social(attraction: Attraction, configuration: &Configuration, pull: &mut Vec<[f64; 2]>) {
    match attraction {
        Attraction::All => all(&configuration.x, &configuration.y, pull),
    }
}

fn all(x: &[f64], y: &[f64], pull: &mut Vec<[f64; 2]>) {
    pull.clear();
    let n = x.len();
    if n < 2 {
        pull.resize(n, [0.0; 2]);
        return;
    }
    let share = 1.0 / (n as f64 - 1.0);
    let (x_blocks, x_rest) = x.as_chunks::<LANES>();
    let (y_blocks, y_rest) = y.as_chunks::<LANES>();
    for (&xi, &yi) in x.iter().zip(y) {
        let (mut sum_x, mut sum_y) = ([0.0; LANES], [0.0; LANES]);
        for (block_x, block_y) in x_blocks.iter().zip(y_blocks) {
            for lane in 0..LANES {
                let unit = unit_vector(block_x[lane] - xi, block_y[lane] - yi);
                sum_x[lane] += unit[0];
                sum_y[lane] += unit[1];
            }
        }
        let mut total = [0.0, 0.0];
        for (&xj, &yj) in x_rest.iter().zip(y_rest) {
            let unit = unit_vector(xj - xi, yj - yi);
            total = [total[0] + unit[0], total[1] + unit[1]];
        }
        for lane in 0..LANES {
            total = [total[0] + sum_x[lane], total[1] + sum_y[lane]];
        }
        pull.push([total[0] * share, total[1] * share]);
    }
}

/// The smallest normal number added keeps the individual itself, and any at the same place,
/// at exactly zero without a branch; beside any other square it vanishes.
fn unit_vector(dx: f64, dy: f64) -> [f64; 2] {
    let inverse = 1.0 / (dx * dx + dy * dy + f64::MIN_POSITIVE).sqrt();
    [dx * inverse, dy * inverse]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pull_of(places: &[[f64; 2]]) -> Vec<[f64; 2]> {
        let mut configuration = Configuration::default();
        places.iter().for_each(|place| {
            configuration.push(place[0], place[1], 0.0);
        });
        let mut pull = Vec::new();
        social(Attraction::All, &configuration, &mut pull);
        pull
    }

    #[test]
    fn one_alone_is_pulled_nowhere() {
        assert_eq!(pull_of(&[[3.0, 4.0]]), [[0.0, 0.0]]);
    }

    #[test]
    fn two_are_pulled_towards_each_other_whatever_their_distance() {
        let pull = pull_of(&[[0.0, 0.0], [30.0, 40.0]]);
        assert!((pull[0][0] - 0.6).abs() < 1e-15 && (pull[0][1] - 0.8).abs() < 1e-15);
        assert_eq!(pull[1], [-pull[0][0], -pull[0][1]]);
    }

    #[test]
    fn an_individual_at_the_same_place_counts_but_pulls_nowhere() {
        let pull = pull_of(&[[0.0, 0.0], [0.0, 0.0], [5.0, 0.0]]);
        assert_eq!(pull, [[0.5, 0.0], [0.5, 0.0], [-1.0, 0.0]]);
    }

    #[test]
    fn lanes_and_rest_add_up_to_the_plain_sum() {
        let places: Vec<[f64; 2]> = (0..21)
            .map(|k| {
                [
                    libm::sin(f64::from(k) * 1.7) * 4.0,
                    libm::cos(f64::from(k * k)) * 3.0,
                ]
            })
            .collect();
        for (i, pull) in pull_of(&places).iter().enumerate() {
            let mut plain = [0.0, 0.0];
            for (j, place) in places.iter().enumerate().filter(|&(j, _)| j != i) {
                let (dx, dy) = (place[0] - places[i][0], place[1] - places[i][1]);
                assert!(i != j);
                plain = [
                    plain[0] + dx / dx.hypot(dy) / 20.0,
                    plain[1] + dy / dx.hypot(dy) / 20.0,
                ];
            }
            assert!((pull[0] - plain[0]).abs() < 1e-15 && (pull[1] - plain[1]).abs() < 1e-15);
        }
    }
}

//! Which part of the plane is in sight.

use jostle_proto::State;

/// A body's length and half of its width beyond the outermost centre, and some air.
const AIR: f64 = 1.2;
/// A group that fills less than this share of what is in sight is looked at from nearer.
const SMALL: f64 = 0.55;
/// How much more than it needs a group gets.
const ROOM: f64 = 1.1;
/// How much one key press zooms, and how far it pans as a share of what is in sight.
const ZOOM: f64 = 1.25;
const PAN: f64 = 0.25;
/// What may be in sight: from less than a body to more than any group.
const REACHES: (f64, f64) = (0.5, 1e6);

/// A rectangle that is in sight as a whole.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Its centre, in absolute positions.
    pub centre: [f64; 2],
    /// Half of its width and of its height; none before there was anything to see.
    pub reach: Option<[f64; 2]>,
    /// Whether it goes along with the group.
    pub follows: bool,
    /// Whether it keeps the whole group in sight.
    fits: bool,
}

impl Default for Camera {
    fn default() -> Self {
        Camera {
            centre: [0.0, 0.0],
            reach: None,
            follows: true,
            fits: true,
        }
    }
}

impl Camera {
    /// Goes along with a group.
    pub fn see(&mut self, state: &State) {
        if state.id.is_empty() {
            return;
        }
        let centre = centre_of(state);
        if self.follows {
            self.centre = centre;
        }
        let needed = reach_of(state, self.centre).map(|it| it + AIR);
        let reach = self.reach.get_or_insert(needed.map(|it| it * ROOM));
        if self.fits {
            for (reach, needed) in reach.iter_mut().zip(needed) {
                // Not at every step, or the picture would breathe.
                if needed > *reach || needed < SMALL * *reach {
                    *reach = needed * ROOM;
                }
            }
        }
    }

    /// Looks from nearer, or from farther away.
    pub fn zoom(&mut self, is_nearer: bool) {
        self.fits = false;
        let factor = if is_nearer { 1.0 / ZOOM } else { ZOOM };
        let scaled = |reach: f64| (reach * factor).clamp(REACHES.0, REACHES.1);
        self.reach = self.reach.map(|reach| reach.map(scaled));
    }

    /// Looks elsewhere.
    pub fn pan(&mut self, x: f64, y: f64) {
        self.follows = false;
        self.fits = false;
        let [across, up] = self.reach.unwrap_or_default();
        self.centre[0] += PAN * across * x;
        self.centre[1] += PAN * up * y;
    }

    /// Follows the group again and has all of it in sight; lets go of it if it does both.
    pub fn follow(&mut self) {
        let does_both = self.follows && self.fits;
        self.follows = !does_both;
        self.fits = !does_both;
        if self.fits {
            self.reach = None;
        }
    }
}

/// Where the positions of a state are counted from.
pub fn origin_of(state: &State) -> [f64; 2] {
    state.origin.map(|origin| 1024.0 * origin as f64)
}

/// The centre of mass.
fn centre_of(state: &State) -> [f64; 2] {
    let n = state.id.len() as f64;
    let [x, y] = origin_of(state);
    let mean = |column: &[f64]| column.iter().sum::<f64>() / n;
    [x + mean(&state.x), y + mean(&state.y)]
}

/// How far from `centre` the outermost bodies are, across and up.
fn reach_of(state: &State, centre: [f64; 2]) -> [f64; 2] {
    let [x, y] = origin_of(state);
    let farthest = |column: &[f64], from: f64| {
        let distances = column.iter().map(|it| (it - from).abs());
        distances.fold(0.0, f64::max)
    };
    [
        farthest(&state.x, centre[0] - x),
        farthest(&state.y, centre[1] - y),
    ]
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::super::snapshots::state_of;
    use super::*;

    #[test]
    fn it_follows_the_centre_of_mass_and_keeps_all_in_sight() {
        let mut camera = Camera::default();
        camera.see(&state_of(&[(0.0, 0.0, 0.0, 0.0), (4.0, 2.0, 0.0, 0.0)]));
        assert_eq!(camera.centre, [2.0, 1.0]);
        let before = camera;
        assert!(before.reach.unwrap()[0] > 2.8 && before.reach.unwrap()[1] > 1.8);
        camera.see(&state_of(&[(0.1, 0.0, 0.0, 0.0), (4.0, 2.0, 0.0, 0.0)]));
        assert_eq!(camera.reach, before.reach, "it does not breathe");
        camera.see(&state_of(&[(0.0, 0.0, 0.0, 0.0), (40.0, 2.0, 0.0, 0.0)]));
        assert!(camera.reach.unwrap()[0] > 20.0);
    }

    #[test]
    fn who_pans_or_zooms_is_left_alone_until_told_to_follow() {
        let group = state_of(&[(0.0, 0.0, 0.0, 0.0)]);
        let mut camera = Camera::default();
        camera.see(&group);
        camera.pan(1.0, 0.0);
        camera.zoom(true);
        let left = camera;
        camera.see(&group);
        assert_eq!(camera, left);
        assert!(left.centre[0] > 0.0 && !left.follows);
        camera.follow();
        camera.see(&group);
        assert_eq!(camera.centre, [0.0, 0.0]);
        camera.follow();
        assert!(!camera.follows, "the same key lets go");
    }
}

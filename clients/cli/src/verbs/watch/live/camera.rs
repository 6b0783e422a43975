//! The visible part of the plane.

use jostle_proto::State;

/// Space beyond the outermost centre: a body's length, half of its width and a margin.
const MARGIN: f64 = 1.2;
/// The camera zooms in when the group fills less than this share.
const MIN_SHARE: f64 = 0.55;
/// Extra space after a change of the zoom, as a factor.
const SLACK: f64 = 1.1;
/// The zoom factor of one key press, and its pan as a share of the visible width.
const ZOOM: f64 = 1.25;
const PAN: f64 = 0.25;
/// The limits of the zoom: less than a body, and more than any group.
const REACH_LIMITS: (f64, f64) = (0.5, 1e6);

/// A rectangle that is visible as a whole.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Its centre, in absolute positions.
    pub centre: [f64; 2],
    /// Half of its width and of its height; none before the first state.
    pub reach: Option<[f64; 2]>,
    /// Whether it follows the group.
    pub follows: bool,
    /// Whether it keeps the whole group visible.
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
    /// Moves with the group.
    pub fn track(&mut self, state: &State) {
        if state.id.is_empty() {
            return;
        }
        let centre = centre_of(state);
        if self.follows {
            self.centre = centre;
        }
        let needed = reach_of(state, self.centre).map(|it| it + MARGIN);
        let reach = self.reach.get_or_insert(needed.map(|it| it * SLACK));
        if self.fits {
            for (reach, needed) in reach.iter_mut().zip(needed) {
                // With hysteresis: a zoom that changes at every step is unpleasant.
                if needed > *reach || needed < MIN_SHARE * *reach {
                    *reach = needed * SLACK;
                }
            }
        }
    }

    /// Zooms in or out.
    pub fn zoom(&mut self, is_in: bool) {
        self.fits = false;
        let factor = if is_in { 1.0 / ZOOM } else { ZOOM };
        let scaled = |reach: f64| (reach * factor).clamp(REACH_LIMITS.0, REACH_LIMITS.1);
        self.reach = self.reach.map(|reach| reach.map(scaled));
    }

    /// Moves the camera by hand, which stops following.
    pub fn pan(&mut self, x: f64, y: f64) {
        self.follows = false;
        self.fits = false;
        let [across, up] = self.reach.unwrap_or_default();
        self.centre[0] += PAN * across * x;
        self.centre[1] += PAN * up * y;
    }

    /// Follows the whole group again; stops if it does so already.
    pub fn follow(&mut self) {
        let does_both = self.follows && self.fits;
        self.follows = !does_both;
        self.fits = !does_both;
        if self.fits {
            self.reach = None;
        }
    }
}

/// The origin of a state's positions.
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

/// The distances of the outermost bodies from `centre`, along both axes.
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
    fn it_follows_the_centre_of_mass_and_keeps_all_visible() {
        let mut camera = Camera::default();
        camera.track(&state_of(&[(0.0, 0.0, 0.0, 0.0), (4.0, 2.0, 0.0, 0.0)]));
        assert_eq!(camera.centre, [2.0, 1.0]);
        let before = camera;
        assert!(before.reach.unwrap()[0] > 2.8 && before.reach.unwrap()[1] > 1.8);
        camera.track(&state_of(&[(0.1, 0.0, 0.0, 0.0), (4.0, 2.0, 0.0, 0.0)]));
        assert_eq!(camera.reach, before.reach, "the zoom has hysteresis");
        camera.track(&state_of(&[(0.0, 0.0, 0.0, 0.0), (40.0, 2.0, 0.0, 0.0)]));
        assert!(camera.reach.unwrap()[0] > 20.0);
    }

    #[test]
    fn pan_and_zoom_stop_following_until_the_follow_key() {
        let group = state_of(&[(0.0, 0.0, 0.0, 0.0)]);
        let mut camera = Camera::default();
        camera.track(&group);
        camera.pan(1.0, 0.0);
        camera.zoom(true);
        let left = camera;
        camera.track(&group);
        assert_eq!(camera, left);
        assert!(left.centre[0] > 0.0 && !left.follows);
        camera.follow();
        camera.track(&group);
        assert_eq!(camera.centre, [0.0, 0.0]);
        camera.follow();
        assert!(!camera.follows, "the same key stops following");
    }
}

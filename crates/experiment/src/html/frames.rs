//! Frames in an HTML file: positions and headings as whole numbers, of which the file has the differences to
//! a prediction, compressed.

use std::collections::HashMap;
use std::f64::consts::TAU;

use jostle_physics::model::{CELL, State};
use serde::{Deserialize, Serialize};

use crate::html::packed;

/// The unit of positions, in body sizes: below a pixel of the player.
const QUANTUM: f64 = 0.01;

/// The number of units of a heading in a full turn.
const TURN: u32 = 1024;

/// The frames of a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EncodedFrames {
    /// Their number.
    pub count: u64,
    /// The duration of a step.
    pub dt: f64,
    /// The unit of positions, in body sizes.
    pub quantum: f64,
    /// The number of units of a heading in a full turn.
    pub turn: u32,
    /// Length over width of a body, each from a frame on.
    pub pi1: Vec<(u64, f64)>,
    /// The numbers of the frames: base64 of gzip.
    pub data: String,
}

/// The bodies of a frame: columns of one length.
#[derive(Clone, Copy, Debug)]
pub struct FrameOfBodies<'a> {
    /// The number of steps since the start.
    pub step: u64,
    /// Ids.
    pub id: &'a [u32],
    /// Positions along x.
    pub x: &'a [f64],
    /// Positions along y.
    pub y: &'a [f64],
    /// Headings in radians.
    pub alpha: &'a [f64],
    /// Weights of the preferred directions; 0 for the uninformed.
    pub weight: &'a [f64],
}

/// Encodes frames, one after the other.
///
/// The numbers are LEB128, signed ones zig-zag. Those of a frame are: the difference of its step; 0 if it has
/// the ids and the informed individuals of the frame before, else n + 1, the differences of the ids, and
/// for each 1 if it is informed; then x, y and heading of all individuals, less the prediction from the
/// two frames before.
#[derive(Debug)]
pub struct FrameEncoder {
    dt: f64,
    count: u64,
    bytes: Vec<u8>,
    pi1: Vec<(u64, f64)>,
    step: u64,
    group: Vec<(u32, bool)>,
    /// The units of each individual in the last frame, and in the one before.
    last: HashMap<u32, [i64; 3]>,
    before: HashMap<u32, [i64; 3]>,
}

impl FrameEncoder {
    /// Begins with the duration of a step.
    #[must_use]
    pub fn new(dt: f64) -> Self {
        Self {
            dt,
            count: 0,
            bytes: Vec::new(),
            pi1: Vec::new(),
            step: 0,
            group: Vec::new(),
            last: HashMap::new(),
            before: HashMap::new(),
        }
    }

    /// Adds the state of a run.
    pub fn add_state(&mut self, state: &State) {
        let bodies = &state.configuration;
        let [x, y] = bodies.origin.map(|origin| CELL * origin as f64);
        let shifted = |column: &[f64], by: f64| column.iter().map(|it| it + by).collect::<Vec<_>>();
        let frame = FrameOfBodies {
            step: state.step,
            id: &bodies.id,
            x: &shifted(&bodies.x, x),
            y: &shifted(&bodies.y, y),
            alpha: &bodies.alpha,
            weight: &bodies.weight,
        };
        self.add(&frame, state.parameters.pi1);
    }

    /// Adds a frame of bodies with this ratio of length to width.
    pub fn add(&mut self, frame: &FrameOfBodies<'_>, pi1: f64) {
        if self.pi1.last().is_none_or(|&(_, last)| last != pi1) {
            self.pi1.push((self.count, pi1));
        }
        self.count += 1;
        self.signed(difference(frame.step, self.step));
        self.step = frame.step;
        let weights = frame.weight.iter();
        let informed = weights.map(|weight| *weight > 0.0);
        let group: Vec<(u32, bool)> = frame.id.iter().copied().zip(informed).collect();
        if self.count > 1 && group == self.group {
            self.unsigned(0);
        } else {
            self.unsigned(group.len() as u64 + 1);
            let mut last = 0;
            for &(id, _) in &group {
                self.signed(i64::from(id) - last);
                last = i64::from(id);
            }
            for &(_, is_informed) in &group {
                self.unsigned(u64::from(is_informed));
            }
        }
        self.group = group;
        let mut units = HashMap::with_capacity(frame.id.len());
        for (index, &id) in frame.id.iter().enumerate() {
            let of_alpha = frame.alpha[index] / TAU * f64::from(TURN);
            let position = [frame.x[index], frame.y[index]].map(|it| whole(it / QUANTUM));
            units.insert(id, [position[0], position[1], whole(of_alpha)]);
        }
        for column in 0..3 {
            for id in frame.id {
                let predicted = match (self.last.get(id), self.before.get(id)) {
                    (Some(last), Some(before)) => 2 * last[column] - before[column],
                    (Some(last), None) => last[column],
                    (None, _) => 0,
                };
                self.signed(units[id][column] - predicted);
            }
        }
        self.before = std::mem::replace(&mut self.last, units);
    }

    /// Returns the number of bytes before compression.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.bytes.len()
    }

    /// Returns the frames.
    #[must_use]
    pub fn finish(self) -> EncodedFrames {
        EncodedFrames {
            count: self.count,
            dt: self.dt,
            quantum: QUANTUM,
            turn: TURN,
            pi1: self.pi1,
            data: packed(&self.bytes),
        }
    }

    fn unsigned(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.bytes.push(0x80 | low_bits(value));
            value >>= 7;
        }
        self.bytes.push(low_bits(value));
    }

    fn signed(&mut self, value: i64) {
        self.unsigned((value << 1 ^ value >> 63).cast_unsigned());
    }
}

/// The lowest seven bits.
fn low_bits(value: u64) -> u8 {
    (value & 0x7f).to_le_bytes()[0]
}

fn difference(one: u64, other: u64) -> i64 {
    one.wrapping_sub(other).cast_signed()
}

/// The nearest whole number.
#[expect(
    clippy::cast_possible_truncation,
    reason = "coordinates are far below 2^63 units"
)]
fn whole(value: f64) -> i64 {
    value.round() as i64
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::io::Read as _;

    use base64::Engine as _;
    use base64::engine::general_purpose::STANDARD;
    use flate2::read::GzDecoder;

    use super::*;

    fn numbers(frames: &EncodedFrames) -> Vec<u64> {
        let gzip = STANDARD.decode(&frames.data).unwrap();
        let mut bytes = Vec::new();
        GzDecoder::new(&*gzip).read_to_end(&mut bytes).unwrap();
        let (mut numbers, mut value, mut shift) = (Vec::new(), 0, 0);
        for byte in bytes {
            value |= u64::from(byte & 0x7f) << shift;
            shift += 7;
            if byte < 0x80 {
                numbers.push(value);
                (value, shift) = (0, 0);
            }
        }
        assert_eq!(shift, 0);
        numbers
    }

    #[test]
    fn the_numbers_of_frames_are_those_of_the_format() {
        let mut encoder = FrameEncoder::new(0.02);
        let frame = |step, id, x, alpha, weight| FrameOfBodies {
            step,
            id,
            x,
            y: &[1.0, -1.0][..x.len()],
            alpha,
            weight,
        };
        let both = [3, 200];
        encoder.add(
            &frame(10, &both, &[0.0, 2.0], &[0.0, TAU / 4.0], &[0.0, 0.5]),
            4.0,
        );
        encoder.add(
            &frame(20, &both, &[0.03, 2.0], &[0.0, TAU / 4.0], &[0.0, 0.5]),
            4.0,
        );
        encoder.add(
            &frame(
                30,
                &both,
                &[0.06, 1.99],
                &[-TAU / 1024.0, TAU / 4.0],
                &[0.0, 0.5],
            ),
            3.0,
        );
        // A reset, and one individual less.
        encoder.add(&frame(0, &[3], &[0.06], &[0.0], &[0.0]), 3.0);
        let frames = encoder.finish();
        assert_eq!((frames.count, frames.dt), (4, 0.02));
        assert_eq!(frames.pi1, [(0, 4.0), (2, 3.0)]);
        let expected: [&[u64]; 4] = [
            &[20, 3, 6, 394, 0, 1, 0, 400, 200, 199, 0, 512],
            &[20, 0, 6, 0, 0, 0, 0, 0],
            // 0.06 is where the step before leads.
            &[20, 0, 0, 1, 0, 0, 1, 0],
            // 2 · 6 - 3 = 9 is expected, -2 is the turn.
            &[59, 2, 6, 0, 5, 0, 4],
        ];
        assert_eq!(numbers(&frames), expected.concat());
    }
}

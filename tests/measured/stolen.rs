//! The time that the host of a virtual machine takes from its processors.

use std::fs;

/// Counts it from now on.
pub struct Stolen {
    stolen: f64,
    all: f64,
}

impl Stolen {
    pub fn begin() -> Self {
        let stat = fs::read_to_string("/proc/stat").unwrap();
        let ticks = stat.lines().next().unwrap().split_whitespace();
        // user, nice, system, idle, iowait, irq, softirq, steal; guests are counted in the first two.
        let ticks = ticks.skip(1).take(8).map(|it| it.parse().unwrap());
        let ticks: Vec<f64> = ticks.collect();
        Stolen {
            stolen: ticks[7],
            all: ticks.iter().sum(),
        }
    }

    /// The share of all processors' time since the beginning, which is some seconds ago.
    pub fn share(&self) -> f64 {
        let now = Self::begin();
        let share = (now.stolen - self.stolen) / (now.all - self.all);
        println!("the host took {share:.3} of the processors' time");
        share
    }
}

//! Command line of the bench.

use std::path::PathBuf;

use clap::Parser;

use jostle_physics::model::simd::Level;

use super::backend::Backend;
use super::rapier;
use super::settled::Case;

/// Thread CPU time of a step of settled groups in µs: the exact solver, and others on the same work
#[derive(Debug, Parser)]
#[command(bin_name = "cargo bench -p jostle-physics-benches --bench step --")]
pub struct Arguments {
    /// Print one JSON object per line instead of a table
    #[arg(long)]
    pub json: bool,
    /// Ratios of length to width, separated by commas
    #[arg(long, value_delimiter = ',', default_values_t = [1.0, 2.0, 4.0, 8.0])]
    pub pi1: Vec<f64>,
    /// Numbers of individuals [default: 10,50,74,120,200,500,1000, and 2000 at pi1 = 4]
    #[arg(long, value_delimiter = ',')]
    pub n: Vec<usize>,
    /// Backends to measure [default: all that are installed]
    #[arg(long, value_delimiter = ',', value_enum)]
    pub backends: Vec<Backend>,
    /// Take fewer steps and samples: about a tenth of the time
    #[arg(long)]
    pub quick: bool,
    /// Sweeps of rapier over its contacts in a step
    #[arg(long, value_name = "COUNT", default_value_t = rapier::SWEEPS)]
    pub sweeps: usize,
    /// Limit our kernels to SSE2, which every x86-64 has and the other solvers use
    #[arg(long)]
    pub baseline: bool,
    /// Also draw the time against n at pi1 = 4
    #[arg(long, value_name = "FILE")]
    pub svg: Option<PathBuf>,
    /// Update the tables of docs/performance.md, and the tables and the figure in docs/performance
    #[arg(long)]
    pub write_docs: bool,
    /// Python interpreter for daqp and piqp
    #[arg(long, value_name = "PROGRAM", default_value = "python3")]
    pub python: PathBuf,
    /// Appended by cargo.
    #[arg(long, hide = true)]
    bench: bool,
}

/// Default numbers of individuals.
const COUNTS: [usize; 7] = [10, 50, 74, 120, 200, 500, 1000];

/// Length over width and number of individuals of the largest group, measured by default only at
/// this ratio.
const LARGEST: (f64, usize) = (4.0, 2000);

impl Arguments {
    /// Returns the groups to measure, in the order of the table.
    pub fn cases(&self) -> Vec<Case> {
        let mut cases = Vec::new();
        for &pi1 in &self.pi1 {
            let mut counts = self.n.clone();
            if counts.is_empty() {
                counts.extend(COUNTS);
                if pi1 == LARGEST.0 {
                    counts.push(LARGEST.1);
                }
            }
            cases.extend(counts.into_iter().map(|n| Case { pi1, n }));
        }
        cases
    }

    /// Returns the SIMD level of our kernels.
    pub fn level(&self) -> Level {
        if self.baseline {
            return Level::BASELINE;
        }
        Level::default()
    }

    /// Returns whether `backend` is selected.
    pub fn selects(&self, backend: Backend) -> bool {
        self.backends.is_empty() || self.backends.contains(&backend)
    }
}

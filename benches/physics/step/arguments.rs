//! What can be asked of the bench.

use std::path::PathBuf;

use clap::Parser;

use jostle_physics::model::simd::Level;

use super::backend::Backend;
use super::rapier;
use super::settled::Case;

/// µs a step of settled groups costs, in thread CPU time: ours, and outsiders on the same work
#[derive(Debug, Parser)]
#[command(bin_name = "cargo bench --bench step --")]
pub struct Arguments {
    /// One JSON object a line instead of a table
    #[arg(long)]
    pub json: bool,
    /// Lengths over width, separated by commas
    #[arg(long, value_delimiter = ',', default_values_t = [1.0, 2.0, 4.0, 8.0])]
    pub pi1: Vec<f64>,
    /// Numbers of individuals [default: 10,50,74,120,200,500,1000, and 2000 at pi1 = 4]
    #[arg(long, value_delimiter = ',')]
    pub n: Vec<usize>,
    /// Who is measured [default: all that are present]
    #[arg(long, value_delimiter = ',', value_enum)]
    pub backends: Vec<Backend>,
    /// Fewer steps, fewer repetitions: to a tenth or so
    #[arg(long)]
    pub quick: bool,
    /// How often rapier sweeps over its contacts in a step
    #[arg(long, value_name = "COUNT", default_value_t = rapier::SWEEPS)]
    pub sweeps: usize,
    /// Hold our kernels to the vectors that every x86-64 has (SSE2), as the outsiders are
    #[arg(long)]
    pub baseline: bool,
    /// Also draws cost against n at pi1 = 4
    #[arg(long, value_name = "FILE")]
    pub svg: Option<PathBuf>,
    /// Renews the tables and the picture of docs/performance.md
    #[arg(long)]
    pub write_docs: bool,
    /// The Python that may have daqp and piqp
    #[arg(long, value_name = "PROGRAM", default_value = "python3")]
    pub python: PathBuf,
    /// What cargo appends.
    #[arg(long, hide = true)]
    bench: bool,
}

/// The numbers of individuals measured unless told otherwise.
const COUNTS: [usize; 7] = [10, 50, 74, 120, 200, 500, 1000];

/// The one that is measured only at the length over width most used.
const LARGEST: (f64, usize) = (4.0, 2000);

impl Arguments {
    /// The groups asked for, in the order of the table.
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

    /// Which version of our kernels is measured.
    pub fn level(&self) -> Level {
        if self.baseline {
            return Level::BASELINE;
        }
        Level::default()
    }

    /// Whether `backend` was asked for.
    pub fn wants(&self, backend: Backend) -> bool {
        self.backends.is_empty() || self.backends.contains(&backend)
    }
}

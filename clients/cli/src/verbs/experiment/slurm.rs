//! The Slurm script of an experiment: a job array, one element for each part.

use std::fmt::Write as _;

use jostle_experiment::shell::quoted;
use jostle_experiment::{Plan, Subset};

use crate::format;

/// The expected time of a part is correct within this factor.
const TIME_FACTOR: f64 = 3.0;

/// Time for the start of a job and for writing its tables, in minutes.
const SPARE_MINUTES: u64 = 2;

/// Memory in MB: of a process of `jostled run` with one thread, of an individual, and of an entry of a
/// time series.
const MEMORY: f64 = 64.0;
const MEMORY_OF_INDIVIDUAL: f64 = 0.02;
const MEMORY_OF_ENTRY: f64 = 2e-4;

/// Memory in MB of a run of the plan and, in addition, of a run of the part. Measured: parts of 1 and
/// 25,000 of 100,000 runs take 32 and 78 MB, and a part of 1 of 10,000 runs 15 MB.
const MEMORY_OF_PLANNED: f64 = 2e-4;
const MEMORY_OF_RUN: f64 = 3e-3;

/// The largest index of a job array, unless Slurm's `MaxArraySize` is raised.
const MAX_INDEX: usize = 1000;

/// A part of an experiment, which one machine executes.
pub struct Part {
    /// Its number, from 1.
    pub number: usize,
    /// The runs of it that are to be executed.
    pub runs: Subset,
}

/// Returns the script. `parts` are those to execute, of `of` parts; they are written to `folder`.
pub fn script(plan: &Plan, file: &str, parts: &[Part], of: usize, folder: &str) -> String {
    let numbers = Subset::of(parts.iter().map(|part| part.number - 1).collect());
    let longest = parts.iter().map(|part| part.runs.expected_secs(plan));
    let minutes = minutes(longest.fold(0.0, f64::max));
    let runs: usize = parts.iter().map(|part| part.runs.indices().len()).sum();
    let memory = plan.runs().iter().map(|run| {
        let point = plan.point(run);
        let entries = plan.entries(run);
        MEMORY_OF_INDIVIDUAL * point.spec.n as f64 + MEMORY_OF_ENTRY * entries as f64
    });
    let most = parts.iter().map(|part| part.runs.indices().len()).max();
    let memory = MEMORY
        + memory.fold(0.0, f64::max)
        + MEMORY_OF_PLANNED * plan.runs().len() as f64
        + MEMORY_OF_RUN * most.unwrap_or(0) as f64;
    let (name, file) = (&plan.name, quoted(file));
    let folder = quoted(folder);
    let counted = format::count(runs as u64, "run");
    let what = format::count(parts.len() as u64, "part");
    let mut script = format!(
        "\
#!/bin/bash
# {counted} of experiment {name} in {what}, each on one core. Run `sbatch` in the folder to which the
# paths below are relative. When all elements have finished:
#
#   jostle results merge {folder} -o {name}-results
#
# If runs are missing, the error names them. To submit the incomplete parts again, print another script:
#
#   jostle experiment plan {file} --parts {of} --emit slurm --missing {folder}
#
#SBATCH --job-name={name}
#SBATCH --array={numbers}
#SBATCH --ntasks=1
#SBATCH --cpus-per-task=1
#SBATCH --mem={memory:.0}M
#SBATCH --time={minutes}
#SBATCH --requeue
#SBATCH --signal=B:TERM@30
#SBATCH --output={name}-%A_%a.log
"
    );
    if parts.iter().any(|part| part.number > MAX_INDEX) {
        let _ = write!(
            script,
            "#
# The largest index of an array is {MAX_INDEX} unless Slurm's MaxArraySize is raised:
# `scontrol show config | grep MaxArraySize`.
"
        );
    }
    let _ = write!(
        script,
        "
# Slurm sends SIGTERM 30 s before the time limit: jostled writes checkpoints and exits. `exec` makes
# it the process that receives the signal.
exec jostled run {file} --part \"$SLURM_ARRAY_TASK_ID/{of}\" --threads 1 --checkpoint 5m \\
  -o {folder}/part-\"$SLURM_ARRAY_TASK_ID\"
"
    );
    script
}

/// The time limit of a part, in minutes.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "positive and below 10^12"
)]
fn minutes(expected_secs: f64) -> u64 {
    SPARE_MINUTES + (TIME_FACTOR * expected_secs / 60.0).ceil() as u64
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_script_requests_what_its_parts_need() {
        let plan =
            Plan::parse("name = \"order\"\nduration = 1e5\nreplicates = 8\n[spec]\nn = 50\n")
                .unwrap();
        let part = |number| Part {
            number,
            runs: Subset::part(&plan, number, 4).unwrap(),
        };
        let script = script(&plan, "my order.toml", &[part(1), part(3)], 4, "parts");
        for line in [
            "#!/bin/bash",
            "#SBATCH --array=1,3",
            "#SBATCH --mem=65M",
            "#SBATCH --time=11",
            "exec jostled run 'my order.toml' --part \"$SLURM_ARRAY_TASK_ID/4\" --threads 1 \
             --checkpoint 5m \\",
            "  -o parts/part-\"$SLURM_ARRAY_TASK_ID\"",
        ] {
            assert!(script.lines().any(|it| it == line), "{line}:\n{script}");
        }
        assert!(!script.contains("MaxArraySize"));
    }

    #[test]
    fn a_script_requests_memory_for_many_runs() {
        let text = "name = \"a\"\nduration = 1\nreplicates = 100000\nspec = { n = 5 }\n";
        let plan = Plan::parse(text).unwrap();
        let runs = Subset::part(&plan, 1, 4).unwrap();
        let script = script(&plan, "a.toml", &[Part { number: 1, runs }], 4, "parts");
        assert!(script.contains("#SBATCH --mem=159M\n"), "{script}");
    }
}

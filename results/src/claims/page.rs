//! A page of every claim, what was measured, and the figures: all that stands in it is computed.

use std::fmt::Write as _;

use super::{Claim, Evidence, Rule, Verdict, claims, rules};
use crate::Run;
use crate::touch::Touch;

/// How the results on the page came to be, each a command and where its results are.
#[derive(Clone, Debug)]
pub struct Origin {
    /// The commands, one a line.
    pub commands: String,
    /// The figures: their titles and where they are, relative to the page.
    pub figures: Vec<(String, String)>,
}

/// The verdicts of one claim, rule by rule.
type Row<'a> = (&'a Claim, Vec<super::Answer>);

/// Writes the page in Markdown: the same results give the same bytes.
#[must_use]
pub fn page(runs: &[Run], touches: &[Touch], origin: &Origin) -> String {
    let rules = rules(runs);
    let evidence: Vec<Evidence> = rules
        .iter()
        .map(|rule| Evidence::new(rule, runs, touches))
        .collect();
    let claims = claims();
    let rows: Vec<Row> = claims
        .iter()
        .map(|claim| (claim, evidence.iter().map(claim.ask).collect()))
        .collect();
    let mut page = String::new();
    let mut put = |text: &str| page.push_str(text);
    put(HEAD);
    put(&format!("```sh\n{}\n```\n\n", origin.commands.trim_end()));
    put(&of_the_rules(runs, &rules));
    put(&summary(&rules, &rows));
    put("## Claim by claim\n\nErrors are standard errors of means over runs.\n");
    for (claim, answers) in &rows {
        put(&format!(
            "\n### {} {}\n\nHolds: {}.\n\n| contacts | measured | verdict |\n|---|---|---|\n",
            claim.name, claim.says, claim.criterion
        ));
        for (rule, answer) in rules.iter().zip(answers) {
            let (title, verdict) = (title(rule), answer.verdict);
            put(&format!("| {title} | {} | {verdict} |\n", answer.measured));
        }
    }
    put("\n## Figures\n");
    for (title, place) in &origin.figures {
        put(&format!("\n![{title}]({place})\n"));
    }
    page
}

const HEAD: &str = "\
# The paper's results, reproduced

P. L. Várkonyi, *Communication and collective consensus making in animal groups via mechanical
interactions*, J. Nonlinear Sci. 21 (2011). Everything below is written by the last of these
commands from the tables that the others make; nothing is typed by hand.

";

fn title(rule: &Rule) -> String {
    format!("`{}`, dt = {}", rule.contacts, rule.dt)
}

/// What the runs of each rule were like.
fn of_the_rules(runs: &[Run], rules: &[Rule]) -> String {
    let mut table = String::from(
        "| contacts | runs | steps | ended by a fault | time with crossed bodies | at the worst \
         condition | deepest overlap | worst residual | degraded steps | left to the referee |\n\
         |---|---|---|---|---|---|---|---|---|---|\n",
    );
    for rule in rules {
        let these: Vec<&Run> = runs
            .iter()
            .filter(|run| run.contacts == rule.contacts && run.dt == rule.dt)
            .collect();
        let sum = |of: fn(&Run) -> u64| these.iter().map(|run| of(run)).sum::<u64>();
        let largest = |of: fn(&Run) -> f64| these.iter().map(|run| of(run)).fold(0.0, f64::max);
        let time: f64 = these.iter().map(|run| run.time).sum();
        let crossed: f64 = these.iter().map(|run| run.crossed_share * run.time).sum();
        let longest = largest(|run| run.time);
        let ended = these.iter().filter(|run| run.time < longest * (1.0 - 1e-9));
        let conditions =
            crate::statistics::summarise(&these.iter().map(|&run| run.clone()).collect::<Vec<_>>());
        let worst = conditions
            .iter()
            .map(|it| it.crossed_share)
            .fold(0.0, f64::max);
        let _ = writeln!(
            table,
            "| {} | {} | {} | {} | {:.1} % | {:.1} % | {:.2e} | {:.1e} | {} | {} |",
            title(rule),
            these.len(),
            sum(|run| run.steps),
            ended.count(),
            100.0 * crossed / time,
            100.0 * worst,
            largest(|run| run.worst_overlap),
            largest(|run| run.worst_residual),
            sum(|run| run.degraded),
            sum(|run| run.fallbacks),
        );
    }
    table.push('\n');
    table
}

/// All verdicts at a glance, and which of them depend on the rule.
fn summary(rules: &[Rule], rows: &[Row]) -> String {
    let mut text = String::from("## Verdicts\n\n| claim |");
    rules.iter().for_each(|rule| {
        let _ = write!(text, " {} |", title(rule));
    });
    let _ = writeln!(text, "\n|---|{}", "---|".repeat(rules.len()));
    for (claim, answers) in rows {
        let _ = write!(text, "| {} {} |", claim.name, claim.says);
        for answer in answers {
            let verdict = answer.verdict.to_string();
            let verdict = match answer.verdict {
                Verdict::Holds => format!("**{verdict}**"),
                _ => verdict,
            };
            let _ = write!(text, " {verdict} |");
        }
        text.push('\n');
    }
    text.push('\n');
    for (index, rule) in rules.iter().enumerate() {
        let count = |verdict| {
            let alike = rows
                .iter()
                .filter(|(_, answers)| answers[index].verdict == verdict);
            alike.count()
        };
        let _ = writeln!(
            text,
            "- {}: {} hold, {} in part, {} do not.",
            title(rule),
            count(Verdict::Holds),
            count(Verdict::InPart),
            count(Verdict::Fails)
        );
    }
    let depends = |answers: &[super::Answer]| {
        answers
            .windows(2)
            .any(|pair| pair[0].verdict != pair[1].verdict)
    };
    let dependent: Vec<&str> = rows
        .iter()
        .filter(|(_, answers)| depends(answers))
        .map(|(claim, _)| claim.name)
        .collect();
    if rules.len() > 1 {
        let _ = writeln!(
            text,
            "- The rule decides the verdict of {} of {} claims: {}.",
            dependent.len(),
            rows.len(),
            dependent.join(", ")
        );
    }
    text.push('\n');
    text
}

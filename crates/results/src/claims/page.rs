//! A page of every claim with the measured values and the figures. All of its contents are
//! computed.

use std::fmt::Write as _;

use super::{Claim, Evidence, Rule, Verdict, claims, of_difference, rules, with_error};
use crate::touch::Touch;
use crate::{Measure, ResultRow};

/// The origin of the results on a page.
#[derive(Clone, Debug)]
pub struct Origin {
    /// The commands that produced the results, one a line.
    pub commands: String,
    /// The figures: their titles and their paths relative to the page.
    pub figures: Vec<(String, String)>,
}

/// A claim and its answers, rule by rule.
type Row<'a> = (&'a Claim, Vec<super::Answer>);

/// Writes the page in Markdown. The same results give the same bytes.
#[must_use]
pub fn page(runs: &[ResultRow], touches: &[Touch], origin: &Origin) -> String {
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
    put(&meaning(&rules, &evidence));
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

/// The explanation of how a verdict follows from the cases of a claim.
const HOW: &str = "\
A claim speaks of one or more conditions. A condition meets its criterion, or misses it, if the
measured value is more than two standard errors away from the limit. A claim *holds* if all conditions
meet it, and *holds in part* if at least half do and the mean over all conditions is on the claim's side.
Otherwise it *does not hold*. It is *undecided* if the conditions within two standard errors of the limit
decide which of these it is.
";

fn title(rule: &Rule) -> String {
    format!("`{}`, dt = {}", rule.contacts, rule.dt)
}

/// Writes the table of the runs of each rule.
fn of_the_rules(runs: &[ResultRow], rules: &[Rule]) -> String {
    let mut table = String::from(
        "| contacts | runs | steps | ended by a fault | time with crossed bodies | at the worst \
         condition | deepest overlap | worst residual | degraded steps | left to the fallback |\n\
         |---|---|---|---|---|---|---|---|---|---|\n",
    );
    for rule in rules {
        let these: Vec<&ResultRow> = runs
            .iter()
            .filter(|run| run.contacts == rule.contacts && run.dt == rule.dt)
            .collect();
        let numbers = |measure| these.iter().map(move |run| run.number(measure));
        let sum = |measure| numbers(measure).sum::<f64>();
        let largest = |measure| numbers(measure).fold(0.0, f64::max);
        let time: f64 = these.iter().map(|run| run.time).sum();
        let crossed = these
            .iter()
            .map(|run| run.number(Measure::CROSSED_SHARE) * run.time);
        let crossed: f64 = crossed.sum();
        let longest = these.iter().map(|run| run.time).fold(0.0, f64::max);
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
            these.iter().map(|run| run.steps).sum::<u64>(),
            ended.count(),
            100.0 * crossed / time,
            100.0 * worst,
            largest(Measure::WORST_OVERLAP),
            largest(Measure::WORST_RESIDUAL),
            sum(Measure::DEGRADED),
            sum(Measure::FALLBACKS),
        );
    }
    table.push('\n');
    table
}

/// Writes the section on the two readings of contacts and their consequences for the paper.
fn meaning(rules: &[Rule], evidence: &[Evidence]) -> String {
    let of = |name: &str| {
        let index = rules.iter().position(|rule| rule.contacts == name)?;
        evidence.get(index)
    };
    let (Some(exact), Some(literal)) = (of("endpoints"), of("closest")) else {
        return String::new();
    };
    let mut text = String::from(
        "## What the rule decides\n\nThe paper states neither its time step nor its treatment of bodies \
         side by side, whose closest points are not unique. `endpoints` imposes every smooth \
         distance of a pair that no smaller one implies; `closest` follows the appendix literally, \
         one distance a pair. Held by one point, bodies side by side turn into each other, and axes \
         come to cross.\n\n| π1, n | rule | v | n_eff | build-up | breakdown | share of time ordered | \
         share of time with crossed bodies |\n|---|---|---|---|---|---|---|---|\n",
    );
    let mut differ = Vec::new();
    for (pi1, n) in [
        (4.0, 10),
        (8.0, 10),
        (4.0, 50),
        (8.0, 50),
        (4.0, 74),
        (8.0, 74),
    ] {
        let (Some(one), Some(other)) = (exact.one(pi1, n), literal.one(pi1, n)) else {
            continue;
        };
        for (rule, it) in [("endpoints", one), ("closest", other)] {
            let time = |it: Option<crate::statistics::Interval>| {
                it.map_or("not always reached".to_owned(), |it| {
                    with_error(it.mean, it.error)
                })
            };
            let _ = writeln!(
                text,
                "| π1 = {pi1}, n = {n} | `{rule}` | {} | {} | {} | {} | {:.2} | {:.2} |",
                with_error(it.v.mean, it.v.error),
                it.n_eff.map_or("-".to_owned(), |size| format!("{size:.1}")),
                time(it.build_up),
                time(it.breakdown),
                it.ordered_share,
                it.crossed_share
            );
        }
        let error = of_difference(one.v.error, other.v.error).unwrap_or(f64::INFINITY);
        let errors = (one.v.mean - other.v.mean) / error;
        if errors > 3.0 {
            differ.push(format!("π1 = {pi1}, n = {n} ({errors:.1} standard errors)"));
        }
    }
    let _ = writeln!(
        text,
        "\n- Order is greater with exact contacts at {}.",
        if differ.is_empty() {
            "none of these".to_owned()
        } else {
            differ.join(", ")
        }
    );
    if let (Some(one), Some(other)) = (exact.one(4.0, 74), literal.one(4.0, 74)) {
        let shares = [one, other].map(|it| 100.0 * it.ordered_share);
        let _ = writeln!(
            text,
            "- That order falls with n stands under both rules. How far it falls does not: groups of 74 \
             with π1 = 4 are ordered {:.1} % of the time with exact contacts and {:.1} % with \
             `closest`, where some bodies cross {:.1} % of the time. What the paper says of larger \
             groups rests on how its program treated bodies side by side.",
            shares[0],
            shares[1],
            100.0 * other.crossed_share
        );
    }
    text.push_str(
        "- A time step and a treatment of parallel bodies other than these two may give other \
         numbers: `closest` is a reading of the paper, not its program. For its animations the paper \
         gives no number of individuals; here they have 50, and `closest` a time step of 0.05, \
         since bodies at π3 = 10 turn too fast for 0.1.\n\n",
    );
    text
}

/// Writes the table of all verdicts, their totals and the claims whose verdict depends on the rule.
fn summary(rules: &[Rule], rows: &[Row]) -> String {
    let mut text = format!("## Verdicts\n\n{HOW}\n| claim |");
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
            "- {}: {} hold, {} in part, {} do not, {} are undecided.",
            title(rule),
            count(Verdict::Holds),
            count(Verdict::InPart),
            count(Verdict::Fails),
            count(Verdict::Undecided)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::claims::Answer;

    #[test]
    fn the_summary_lists_verdicts_totals_and_claims_that_depend_on_the_rule() {
        let rules = ["endpoints", "closest"].map(|contacts| Rule {
            contacts: contacts.to_owned(),
            dt: 0.02,
        });
        let claims = claims();
        let of = |verdicts: [Verdict; 2]| {
            let answer = |verdict| Answer {
                measured: String::new(),
                verdict,
            };
            verdicts.map(answer).to_vec()
        };
        let verdicts = [
            [Verdict::Holds, Verdict::Holds],
            [Verdict::InPart, Verdict::Fails],
            [Verdict::Undecided, Verdict::Holds],
        ];
        let rows: Vec<Row> = claims.iter().zip(verdicts.map(of)).collect();
        let text = summary(&rules, &rows);
        let row = |index: usize, verdicts: &str| {
            let claim = &claims[index];
            format!("\n| {} {} | {verdicts} |\n", claim.name, claim.says)
        };
        let lines = [
            row(0, "**holds** | **holds**"),
            row(1, "holds in part | does not hold"),
            row(2, "undecided | **holds**"),
            "`endpoints`, dt = 0.02: 1 hold, 1 in part, 0 do not, 1 are undecided.\n".to_owned(),
            "`closest`, dt = 0.02: 2 hold, 0 in part, 1 do not, 0 are undecided.\n".to_owned(),
            format!("2 of 3 claims: {}, {}.\n", claims[1].name, claims[2].name),
        ];
        for line in lines {
            assert!(text.contains(&line), "{line:?} is not in {text}");
        }
    }
}

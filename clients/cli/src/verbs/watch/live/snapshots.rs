//! Drawings of the view at every size, as plain text, and the effects of messages.

#![expect(clippy::unwrap_used, reason = "tests")]

use jostle_proto::verbs::Select;
use jostle_proto::{Event, Phase, Reply, State, Status, SwarmSummary};
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use ratatui::style::{Color, Modifier};
use serde_json::json;

use super::command::Verb;
use super::draw::{Palette, draw};
use super::view::{Action, End, Message, View};
use crate::fixtures;

/// Bodies at (x, y, alpha), with a weight.
pub fn state_of(bodies: &[(f64, f64, f64, f64)]) -> State {
    let column = |what: fn(&(f64, f64, f64, f64)) -> f64| bodies.iter().map(what).collect();
    let status = status();
    State {
        step: 12_345,
        time: 246.9,
        phase: Phase::Running,
        id: (0..).take(bodies.len()).collect(),
        x: column(|it| it.0),
        y: column(|it| it.1),
        alpha: column(|it| it.2),
        weight: column(|it| it.3),
        direction: vec![0.0; bodies.len()],
        order: status.result.order,
        certificate: status.result.certificate,
        ..fixtures::state()
    }
}

/// That of the fixtures, of a running swarm.
fn status() -> Reply<Status> {
    let mut status = fixtures::status();
    status.phase = Phase::Running;
    (status.step, status.time) = (12_345, 246.9);
    status.result.reason = None;
    status.result.informed = 1;
    status.result.order.drift = Some(0.61);
    status.result.real_time_factor = Some(0.98);
    status
}

fn summary(swarm: &str, phase: Phase, n: u64) -> SwarmSummary {
    SwarmSummary {
        swarm: swarm.into(),
        phase,
        reason: None,
        step: 12_345,
        time: 246.9,
        n,
        informed: 0,
        order: 0.5,
        rate: Some(1.0),
        real_time_factor: (phase == Phase::Running).then_some(0.98),
        replay: false,
        protected: false,
        earlier_models: Vec::new(),
        swarm_id: None,
        origin: None,
        contested_by: None,
    }
}

fn list() -> Vec<SwarmSummary> {
    vec![
        summary("broken", Phase::Faulted, 3),
        summary("demo", Phase::Running, 4),
        summary("school-of-the-long-name", Phase::Paused, 2000),
    ]
}

fn event(number: u64, kind: &serde_json::Value) -> Event {
    let event = json!({"swarm": "demo", "number": number, "epoch": 1, "step": 0, "time": 50.0,
                       "phase": "running", "event": kind});
    serde_json::from_value(event).unwrap()
}

/// A view of a swarm of four, one of them informed.
fn view() -> View {
    let mut view = View::new("tcp/127.0.0.1:7447", Some("demo".into()));
    view.update(Message::Swarms(list()));
    for step in 0..12_u32 {
        let mut status = status();
        status.step = u64::from(step);
        status.time = f64::from(step) * 20.0;
        status.result.order.order = f64::from(step) / 12.0;
        status.result.order.drift = (step > 3).then(|| f64::from(step) / 12.0 - 0.3);
        view.update(Message::Status(Box::new(status)));
    }
    view.update(Message::Status(Box::new(status())));
    view.update(Message::State(Box::new(state_of(&[
        (0.0, 0.0, 0.0, 0.0),
        (2.0, 1.5, 1.0, 0.0),
        (-2.0, 1.0, 2.5, 0.5),
        (0.5, -2.0, -0.7, 0.0),
    ]))));
    view.update(Message::Events(vec![
        event(1, &json!({"kind": "created"})),
        event(
            2,
            &json!({"kind": "command", "seq": 1, "verb": "set", "args": {"pi3": 1.0},
                        "client": "ada", "request_id": null}),
        ),
    ]));
    view
}

fn press(view: &mut View, code: KeyCode) -> Vec<Action> {
    view.update(Message::Key(KeyEvent::new(code, KeyModifiers::NONE)))
}

/// The screen, and the buffer behind it.
fn drawn(view: &View, (width, height): (u16, u16), is_coloured: bool) -> TestBackend {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    let palette = Palette { is_coloured };
    terminal.draw(|frame| draw(frame, view, palette)).unwrap();
    terminal.backend().clone()
}

fn text(view: &View, size: (u16, u16)) -> String {
    let backend = drawn(view, size, true);
    let lines = backend.to_string();
    // The backend puts each line into quotes.
    let lines = lines.lines().map(|line| line.trim_matches('"').trim_end());
    lines.collect::<Vec<_>>().join("\n")
}

#[test]
fn drawings_equal_the_snapshots() {
    let mut others = Vec::new();
    for (size, expected) in [
        ((120, 40), include_str!("snapshots/120x40.txt")),
        ((80, 24), include_str!("snapshots/80x24.txt")),
        ((40, 12), include_str!("snapshots/40x12.txt")),
        ((20, 5), include_str!("snapshots/20x5.txt")),
    ] {
        let now = text(&view(), size);
        if now != expected.trim_end() {
            others.push(format!("{}x{}.txt now:\n{now}\n", size.0, size.1));
        }
    }
    assert!(others.is_empty(), "{}", others.join("\n"));
}

#[test]
fn every_popup_can_be_drawn_at_every_size() {
    let mut views = vec![view(), view(), view(), View::new("tcp/h:1", None)];
    press(&mut views[1], KeyCode::Char('?'));
    press(&mut views[2], KeyCode::Char('i'));
    views[3].update(Message::Swarms(Vec::new()));
    for view in &views {
        for width in (1..30).chain([45, 59, 60, 61, 200]) {
            for height in (1..20).chain([60]) {
                drawn(view, (width, height), false);
            }
        }
    }
}

#[test]
fn m_chooses_the_measure_of_the_second_chart() {
    let mut view = view();
    assert!(text(&view, (120, 40)).contains(" drift "));
    press(&mut view, KeyCode::Char('M'));
    let shown = text(&view, (120, 40));
    // No two of the four bodies touch.
    assert!(
        shown.contains(" contacts_per_body 0 individuals"),
        "{shown}"
    );
    assert!(!shown.contains("no common direction"));
    press(&mut view, KeyCode::Char('m'));
    assert!(text(&view, (120, 40)).contains(" drift "));
    press(&mut view, KeyCode::Char('m'));
    press(&mut view, KeyCode::Char('m'));
    let milling = view.measure.map(|it| it.to_string());
    assert_eq!(milling.as_deref(), Some("milling"));
    assert!(text(&view, (120, 40)).contains(" milling 0."));
    for size in [(1, 1), (20, 5), (60, 20)] {
        drawn(&view, size, false);
    }
}

#[test]
fn keys_and_the_prompt_are_shown_in_popups() {
    let mut view = view();
    press(&mut view, KeyCode::Char('?'));
    assert!(text(&view, (80, 24)).contains("quit; the swarms go on"));
    assert!(press(&mut view, KeyCode::Char('i')).is_empty() && view.prompt.is_none());
    press(&mut view, KeyCode::Char('i'));
    let prompting = text(&view, (80, 24));
    assert!(prompting.contains("inform some of demo") && !prompting.contains("quit; the"));
    let tiny = text(&view, (20, 5));
    assert!(tiny.ends_with(" who: 10%▏ a count,…"), "{tiny}");
}

#[test]
fn without_colours_informed_bodies_have_a_mark() {
    let backend = drawn(&view(), (80, 24), false);
    let cells = backend.buffer().content();
    assert_eq!(cells.iter().filter(|cell| cell.symbol() == "●").count(), 1);
    assert!(
        cells
            .iter()
            .all(|cell| cell.fg == Color::Reset && cell.bg == Color::Reset)
    );
    let is_selected = |row: u16| {
        backend.buffer()[(9, row)]
            .modifier
            .contains(Modifier::REVERSED)
    };
    assert!(is_selected(4) && !is_selected(3));
    let coloured = drawn(&view(), (80, 24), true);
    let cells = coloured.buffer().content();
    assert!(cells.iter().any(|cell| cell.fg == Color::Magenta));
    assert!(cells.iter().all(|cell| cell.symbol() != "●"));
}

#[test]
fn keys_become_commands_to_the_selected_swarm() {
    let mut view = view();
    let mut command = |code| match press(&mut view, code).pop() {
        Some(Action::Command(command)) => (command.swarm, command.verb),
        other => panic!("{other:?}"),
    };
    let demo = || "demo".to_owned();
    assert_eq!(command(KeyCode::Char(' ')), (demo(), Verb::Pause));
    assert_eq!(command(KeyCode::Char('s')), (demo(), Verb::Step(1)));
    assert_eq!(command(KeyCode::Char('S')), (demo(), Verb::Step(100)));
    press(&mut view, KeyCode::Char('i'));
    press(&mut view, KeyCode::Enter);
    press(&mut view, KeyCode::Enter);
    let actions = press(&mut view, KeyCode::Enter);
    let [Action::Command(command)] = &actions[..] else {
        panic!("{actions:?}");
    };
    let Verb::Inform(args) = &command.verb else {
        panic!("{command:?}");
    };
    assert_eq!(args.select, Select::Fraction(0.1));
    assert_eq!(view.pending, 4);
    let mut paused = status();
    paused.phase = Phase::Paused;
    view.update(Message::Status(Box::new(paused)));
    let actions = press(&mut view, KeyCode::Char(' '));
    assert!(matches!(&actions[..], [Action::Command(it)] if it.verb == Verb::Run));
    for _ in 0..9 {
        press(&mut view, KeyCode::Char('s'));
    }
    assert!(
        press(&mut view, KeyCode::Char('s')).is_empty(),
        "enough wait"
    );
    let actions = press(&mut view, KeyCode::Char('q'));
    assert!(matches!(&actions[..], [Action::End(End::Quit)]));
}

#[test]
fn another_swarm_is_followed_when_it_is_selected_or_the_selected_one_is_gone() {
    let followed = |actions: Vec<Action>| match &actions[..] {
        [Action::Follow(swarm)] => swarm.clone().unwrap_or_default(),
        other => panic!("{other:?}"),
    };
    let mut view = View::new("tcp/h:1", None);
    assert_eq!(followed(view.update(Message::Swarms(list()))), "broken");
    assert!(press(&mut view, KeyCode::Up).is_empty(), "it is the first");
    assert_eq!(followed(press(&mut view, KeyCode::Down)), "demo");
    view.update(Message::Events(vec![event(9, &json!({"kind": "deleted"}))]));
    let mut rest = list();
    rest.remove(1);
    let next = followed(view.update(Message::Swarms(rest)));
    assert_eq!(next, "school-of-the-long-name");
    assert_eq!(
        view.notice.as_ref().unwrap().text,
        "demo is no longer there"
    );
    for _ in 0..4 {
        view.update(Message::Swarms(Vec::new()));
    }
    assert!(view.selected.is_none());
    assert!(text(&view, (80, 24)).contains("no swarms here"));
    assert!(text(&view, (20, 5)).contains("no swarms here"));
    assert_eq!(followed(view.update(Message::Swarms(list()))), "broken");
}

#[test]
fn a_lost_daemon_is_reported_and_its_swarm_is_followed_after_its_return() {
    let mut view = view();
    view.update(Message::Away("the daemon is gone".into()));
    assert!(text(&view, (80, 24)).ends_with(" the daemon is gone"));
    assert!(
        text(&view, (80, 24)).contains("t 246.9"),
        "the last known values stay"
    );
    let actions = view.update(Message::Swarms(Vec::new()));
    assert!(
        matches!(&actions[..], [Action::Follow(Some(_))]),
        "{actions:?}"
    );
    assert!(text(&view, (80, 24)).ends_with(" the daemon is back"));
    let actions = view.update(Message::Swarms(list()));
    assert!(
        matches!(&actions[..], [Action::Follow(Some(_))]),
        "{actions:?}"
    );
}

#[test]
fn a_message_without_a_change_causes_no_drawing() {
    let mut view = view();
    view.is_changed = false;
    let state = view.selected.as_ref().unwrap().state.clone().unwrap();
    view.update(Message::Swarms(list()));
    view.update(Message::Status(Box::new(status())));
    view.update(Message::State(Box::new(state)));
    view.update(Message::Events(vec![event(
        1,
        &json!({"kind": "phase", "reason": null}),
    )]));
    assert!(!view.is_changed);
    view.update(Message::Outcome(Err("no".into())));
    assert!(view.is_changed && text(&view, (80, 24)).ends_with(" no"));
}

#[test]
fn keys_after_a_swarm_is_gone_do_not_steer_the_one_selected_instead() {
    let mut view = view();
    press(&mut view, KeyCode::Char('i'));
    view.update(Message::Events(vec![event(9, &json!({"kind": "deleted"}))]));
    let mut rest = list();
    rest.remove(1);
    view.update(Message::Swarms(rest));
    for _ in 0..2 {
        press(&mut view, KeyCode::Enter);
    }
    // The prompt is of the swarm for which it was opened.
    let actions = press(&mut view, KeyCode::Enter);
    assert!(
        matches!(&actions[..], [Action::Command(it)] if it.swarm == "demo"),
        "{actions:?}"
    );
    assert!(press(&mut view, KeyCode::Char('s')).is_empty());
    let notice = view.notice.as_ref().unwrap().text.clone();
    assert_eq!(
        notice,
        "school-of-the-long-name is selected now: press again"
    );
    assert_eq!(press(&mut view, KeyCode::Char('s')).len(), 1);
}

#[test]
fn a_filter_shows_and_selects_only_what_it_matches() {
    let mut view = view();
    let typed = |view: &mut View, text: &str| {
        let keys = text.chars().map(KeyCode::Char);
        keys.flat_map(|key| press(view, key)).collect::<Vec<_>>()
    };
    let before = view.selected.as_ref().unwrap().name.clone();
    let actions = typed(&mut view, "/sch");
    assert!(
        matches!(&actions[..], [Action::Follow(Some(it))] if it.starts_with("school")),
        "{actions:?}"
    );
    let shown = text(&view, (80, 24));
    assert!(
        shown.contains(" swarms /sch ") && shown.contains("/sch▏ 1 of 3"),
        "{shown}"
    );
    assert!(!shown.contains("broken"), "{shown}");
    let actions = press(&mut view, KeyCode::Esc);
    assert!(
        matches!(&actions[..], [Action::Follow(Some(it))] if *it == before),
        "{actions:?}"
    );
    assert_eq!(view.visible().count(), 3);
    typed(&mut view, "/*o?e*");
    assert_eq!(
        view.visible()
            .map(|it| it.swarm.as_str())
            .collect::<Vec<_>>(),
        ["broken"]
    );
    press(&mut view, KeyCode::Enter);
    assert!(!view.filter.is_open && press(&mut view, KeyCode::Down).is_empty());
    // The swarm that it shows is gone: none is selected.
    view.update(Message::Swarms(list().split_off(1)));
    for _ in 0..4 {
        view.update(Message::Swarms(list().split_off(1)));
    }
    assert!(view.selected.is_none() && typed(&mut view, "s").is_empty());
    press(&mut view, KeyCode::Esc);
    assert_eq!(view.visible().count(), 2);
}

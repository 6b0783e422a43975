//! All swarms on a terminal: keys, drawing and the bus each on their own, so that none waits for
//! another. What is shown is a pure [`View`], changed by messages and drawn from.

mod camera;
mod chosen;
mod command;
mod draw;
mod follow;
mod history;
mod keys;
mod list;
mod mailbox;
mod prompt;
#[cfg(test)]
mod snapshots;
mod terminal;
mod view;

use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use jostle_proto::{Reply, Status};
use ratatui::crossterm::event::{self, Event};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::sync::oneshot;
use tokio::task::{AbortHandle, JoinSet};

use self::draw::Palette;
use self::mailbox::Mailbox;
use self::terminal::Screen;
pub use self::terminal::restore;
use self::view::{End, Message, View, Wish};
use crate::arguments::WatchArguments;
use crate::bus::Bus;
use crate::failure::Failure;
use crate::interrupt;
use crate::verbs::lookout::reach;

/// The least time between two drawings.
const BETWEEN_DRAWINGS: Duration = Duration::from_millis(50);
/// How long a terminal that takes nothing may hold up the end.
const GRACE: Duration = Duration::from_millis(300);

/// Shows the swarms until whoever looks on has seen enough.
///
/// # Errors
///
/// Why there is nothing to show, or [`Failure::Interrupted`].
pub async fn show(bus: &Arc<Bus>, arguments: &WatchArguments) -> Result<(), Failure> {
    if let Some(swarm) = &arguments.name {
        // A slip of the finger is answered before the screen is taken.
        let there = async { bus.get(swarm, "status").await?.read::<Reply<Status>>() };
        interrupt::either(there).await?;
    }
    let view = View::new(bus.endpoint(), arguments.name.clone());
    let mailbox = Arc::new(Mailbox::default());
    let (to_bus, wishes) = unbounded_channel();
    let mut background = JoinSet::new();
    background.spawn(list::list(bus.clone(), mailbox.clone()));
    background.spawn(grant(bus.clone(), mailbox.clone(), wishes));
    let end = arguments.for_secs.map(Duration::from_secs_f64);
    let end = end.map(|lasting| tokio::time::Instant::now() + lasting);
    let mut shown = draw_on_a_thread(view, mailbox.clone(), to_bus);
    let why = tokio::select! {
        ended = &mut shown => return outcome(ended.ok()),
        () = interrupt::asked_to_end() => End::Interrupted,
        () = reach(end) => End::Quit,
        Some(Err(error)) = background.join_next() => End::Failed(Failure::defect(error)),
    };
    mailbox.post(Message::End(why));
    match tokio::time::timeout(GRACE, shown).await {
        Ok(ended) => outcome(ended.ok()),
        Err(_) => Err(Failure::Interrupted { left: None }),
    }
}

/// What the end of the view means; a thread that panicked says nothing.
fn outcome(end: Option<End>) -> Result<(), Failure> {
    match end {
        Some(End::Quit) => Ok(()),
        Some(End::Interrupted) => Err(Failure::Interrupted { left: None }),
        Some(End::Failed(failure)) => Err(failure),
        None => Err(Failure::defect("drawing ended early")),
    }
}

/// Reads keys on one thread and draws on another.
fn draw_on_a_thread(
    view: View,
    mailbox: Arc<Mailbox>,
    to_bus: UnboundedSender<Wish>,
) -> oneshot::Receiver<End> {
    let (ended, shown) = oneshot::channel();
    thread::spawn(move || {
        let end = Screen::take().and_then(|screen| {
            let keys = mailbox.clone();
            // It ends with the process: nothing else wakes who waits for a key.
            thread::spawn(move || read_keys(&keys));
            draw_until_the_end(screen, view, &mailbox, &to_bus)
        });
        // Nobody waits any more when the terminal held it up for too long.
        let _ = ended.send(end.unwrap_or_else(|error| End::Failed(Failure::Output(error))));
    });
    shown
}

fn read_keys(mailbox: &Mailbox) {
    loop {
        match event::read() {
            Ok(Event::Key(key)) => mailbox.post(Message::Key(key)),
            Ok(Event::Resize(..)) => mailbox.post(Message::Resized),
            Ok(_) => {}
            Err(error) => return mailbox.post(Message::End(End::Failed(Failure::Output(error)))),
        }
    }
}

/// Draws whenever something has changed, but not too often.
fn draw_until_the_end(
    mut screen: Screen,
    mut view: View,
    mailbox: &Mailbox,
    to_bus: &UnboundedSender<Wish>,
) -> std::io::Result<End> {
    let palette = Palette::of_the_environment();
    let mut due = Instant::now();
    loop {
        if view.is_changed && Instant::now() >= due {
            view.is_changed = false;
            screen.draw(|frame| draw::draw(frame, &view, palette))?;
            due = Instant::now() + BETWEEN_DRAWINGS;
        }
        for message in mailbox.take(view.is_changed.then_some(due)) {
            if let Message::End(end) = message {
                return Ok(end);
            }
            for wish in view.update(message) {
                match wish {
                    Wish::End(end) => return Ok(end),
                    // Without the bus's side the process is about to end.
                    wish => drop(to_bus.send(wish)),
                }
            }
        }
    }
}

/// Does what the view wishes: follows a swarm, sends commands.
async fn grant(bus: Arc<Bus>, mailbox: Arc<Mailbox>, mut wishes: UnboundedReceiver<Wish>) {
    let mut tasks = JoinSet::new();
    let mut following: Option<AbortHandle> = None;
    while let Some(wish) = wishes.recv().await {
        while tasks.try_join_next().is_some() {}
        match wish {
            Wish::Follow(swarm) => {
                if let Some(earlier) = following.take() {
                    earlier.abort();
                }
                let follow = |swarm| follow::follow(bus.clone(), mailbox.clone(), swarm);
                following = swarm.map(|swarm| tasks.spawn(follow(swarm)));
            }
            Wish::Command(command) => {
                let (bus, mailbox) = (bus.clone(), mailbox.clone());
                tasks.spawn(async move {
                    let answered = command.send(&bus).await;
                    mailbox.post(Message::Answered(answered.map_err(|it| it.to_string())));
                });
            }
            Wish::End(_) => {}
        }
    }
}

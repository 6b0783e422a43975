//! The full-screen view of all swarms. Keys, drawing and requests have threads and tasks of their
//! own, so that none blocks another; they change the [`View`] by messages.

mod camera;
mod chord;
mod command;
mod draw;
mod filter;
mod follow;
mod history;
mod keys;
mod list;
mod mailbox;
mod measured;
mod prompt;
mod selected;
#[cfg(test)]
mod snapshots;
mod terminal;
mod view;

use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use jostle_client::Client;
use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::sync::oneshot;
use tokio::task::{AbortHandle, JoinSet};

use self::draw::Palette;
use self::mailbox::Mailbox;
pub use self::terminal::restore;
use self::view::{Action, End, Message, View};
use crate::arguments::WatchArguments;
use crate::failure::Failure;
use crate::interrupt;
use crate::verbs::outage::wait_for_deadline;

/// The least time between two drawings.
const DRAW_INTERVAL: Duration = Duration::from_millis(50);
/// How long a terminal that accepts no output may delay the end.
const END_TIMEOUT: Duration = Duration::from_millis(300);

/// Shows the swarms until the user quits.
pub async fn show(client: &Client, arguments: &WatchArguments) -> Result<(), Failure> {
    if let Some(swarm) = &arguments.name {
        // Reports a mistyped name before it takes the terminal.
        interrupt::either(client.status(swarm)).await?;
    }
    let view = View::new(client.endpoint(), arguments.name.clone());
    let mailbox = Arc::new(Mailbox::default());
    let (to_tasks, actions) = unbounded_channel();
    let mut background = JoinSet::new();
    background.spawn(list::list(client.clone(), mailbox.clone()));
    background.spawn(execute(client.clone(), mailbox.clone(), actions));
    let end = arguments.for_secs.map(Duration::from_secs_f64);
    let end = end.map(|lasting| tokio::time::Instant::now() + lasting);
    let mut shown = draw_on_a_thread(view, mailbox.clone(), to_tasks);
    let why = tokio::select! {
        ended = &mut shown => return outcome(ended.ok()),
        () = interrupt::interrupted_or_terminated() => End::Interrupted,
        () = wait_for_deadline(end) => End::Quit,
        Some(Err(error)) = background.join_next() => End::Failed(Failure::defect(error)),
    };
    mailbox.post(Message::End(why));
    match tokio::time::timeout(END_TIMEOUT, shown).await {
        Ok(ended) => outcome(ended.ok()),
        Err(_) => Err(Failure::interrupted()),
    }
}

/// The outcome of the view; none if its thread panicked.
fn outcome(end: Option<End>) -> Result<(), Failure> {
    match end {
        Some(End::Quit) => Ok(()),
        Some(End::Interrupted) => Err(Failure::interrupted()),
        Some(End::Failed(failure)) => Err(failure),
        None => Err(Failure::defect("drawing ended early")),
    }
}

/// Reads keys on one thread and draws on another.
fn draw_on_a_thread(
    view: View,
    mailbox: Arc<Mailbox>,
    to_tasks: UnboundedSender<Action>,
) -> oneshot::Receiver<End> {
    let (ended, shown) = oneshot::channel();
    thread::spawn(move || {
        let end = terminal::take().and_then(|terminal| {
            let keys = mailbox.clone();
            // It ends with the process: nothing else wakes a thread that waits for a key.
            thread::spawn(move || read_keys(&keys));
            draw_until_the_end(terminal, view, &mailbox, &to_tasks)
        });
        // The receiver was dropped if the terminal blocked this thread for too long.
        let _ = ended.send(end.unwrap_or_else(|error| End::Failed(Failure::output(error))));
    });
    shown
}

fn read_keys(mailbox: &Mailbox) {
    loop {
        match event::read() {
            Ok(Event::Key(key)) => mailbox.post(Message::Key(key)),
            Ok(Event::Paste(text)) => mailbox.post(Message::Pasted(text)),
            Ok(Event::Resize(..)) => mailbox.post(Message::Resized),
            Ok(_) => {}
            Err(error) => return mailbox.post(Message::End(End::Failed(Failure::output(error)))),
        }
    }
}

/// Draws whenever something has changed, but not too often.
fn draw_until_the_end(
    mut terminal: DefaultTerminal,
    mut view: View,
    mailbox: &Mailbox,
    to_tasks: &UnboundedSender<Action>,
) -> std::io::Result<End> {
    let palette = Palette::of_the_environment();
    let mut due = Instant::now();
    loop {
        if view.is_changed && Instant::now() >= due {
            view.is_changed = false;
            terminal.draw(|frame| draw::draw(frame, &view, palette))?;
            due = Instant::now() + DRAW_INTERVAL;
        }
        for message in mailbox.take(view.is_changed.then_some(due)) {
            if let Message::End(end) = message {
                return Ok(end);
            }
            for action in view.update(message) {
                match action {
                    Action::End(end) => return Ok(end),
                    // The receiver was dropped if the process is about to end.
                    action => drop(to_tasks.send(action)),
                }
            }
        }
    }
}

/// Executes the view's actions: follows a swarm, sends commands.
async fn execute(client: Client, mailbox: Arc<Mailbox>, mut actions: UnboundedReceiver<Action>) {
    let mut tasks = JoinSet::new();
    let mut following: Option<AbortHandle> = None;
    while let Some(action) = actions.recv().await {
        while tasks.try_join_next().is_some() {}
        match action {
            Action::Follow(swarm) => {
                if let Some(earlier) = following.take() {
                    earlier.abort();
                }
                let follow = |swarm| follow::follow(client.clone(), mailbox.clone(), swarm);
                following = swarm.map(|swarm| tasks.spawn(follow(swarm)));
            }
            Action::Command(command) => {
                let (client, mailbox) = (client.clone(), mailbox.clone());
                tasks.spawn(async move {
                    let outcome = command.send(&client).await;
                    mailbox.post(Message::Outcome(outcome.map_err(|it| it.to_string())));
                });
            }
            Action::End(_) => {}
        }
    }
}

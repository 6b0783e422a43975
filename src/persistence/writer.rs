//! What swarms write down, on its way into the store.

use std::sync::Arc;

use jostle_physics::simulation::Spec;
use jostle_proto as proto;
use serde::{Deserialize, Serialize};

use crate::convert::digest::RequestIdentity;
use crate::convert::{self, Payload, durable};
use crate::store::{self, Store, StoreFault, Write};
use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::error::WriteFault;
use crate::swarm::frame::{Frame, Place};
use crate::swarm::journal::{Done, Wanted, Written};
use crate::swarm::outcome::Outcome;
use crate::swarm::registry::{Archive, Register};

/// What is stored of a swarm beside its journal.
#[derive(Serialize, Deserialize)]
pub(crate) struct About {
    /// What it was created from.
    pub(crate) spec: proto::Spec,
}

/// Writes every swarm's journal to `store`.
pub fn archive(store: &Store) -> Archive {
    let store = store.clone();
    Box::new(move |swarm| {
        let (store, swarm) = (store.clone(), swarm.to_owned());
        Arc::new(move |written, wanted| {
            let writes = written
                .into_iter()
                .flat_map(|it| writes(&swarm, it))
                .collect();
            match wanted {
                Wanted::Now(done) => store.submit(writes, Some(tell(done))),
                Wanted::Soon(None) => store.submit(writes, None),
                Wanted::Soon(Some(told)) => store.submit_then(writes, told),
            }
        })
    })
}

/// Tells a swarm what came of its writes.
fn tell(done: Done) -> store::Done {
    Box::new(move |result| done(result.map_err(fault)))
}

/// Makes a new swarm safe, and with it the answer to whoever asked for it by name.
pub fn register(
    store: &Store,
    swarm: &str,
    recipe: &Spec,
    named: Option<(RequestIdentity, MakePayload)>,
) -> Register {
    let (store, swarm) = (store.clone(), swarm.to_owned());
    let spec = jostle_convert::spec::to_proto(recipe, recipe.seed);
    Box::new(move |checkpoint, place, frame| {
        let mut writes = vec![Write::Create {
            swarm: swarm.clone(),
            about: proto::to_cbor(&About { spec }),
            first: kept(&swarm, checkpoint),
        }];
        if let Some((named, payload)) = named {
            let payload = payload(place, frame);
            writes.push(Write::Answer(store::Answer {
                client: named.client,
                request_id: named.request_id,
                digest: named.digest,
                swarm,
                number: 0,
                is_ok: true,
                encoding: payload.encoding.to_owned(),
                body: payload.bytes,
            }));
        }
        store.commit(writes).map_err(fault)
    })
}

/// Makes the answer of a new swarm's place and frame.
pub type MakePayload = Box<dyn FnOnce(&Place, &Frame) -> Payload + Send>;

/// What is to be stored of what a swarm writes.
pub(crate) fn writes(swarm: &str, written: Written) -> Vec<Write> {
    let swarm = swarm.to_owned();
    match written {
        Written::Line(line) => {
            let (kind, body) = durable::record(&line.record);
            let row = store::Row {
                number: line.number,
                epoch: line.epoch,
                step: line.step,
                kind,
                body,
            };
            vec![Write::Append { swarm, row }]
        }
        Written::Checkpoint(checkpoint) => {
            let checkpoint = kept(&swarm, &checkpoint);
            vec![Write::Keep { swarm, checkpoint }]
        }
        Written::End(place, sender) => {
            let answer = sender.request_id.clone().zip(sender.digest);
            let answer = answer.map(|(request_id, digest)| {
                let payload = convert::outcome(&swarm, &place, Outcome::Done, None);
                Write::Answer(store::Answer {
                    client: sender.client.clone(),
                    request_id,
                    digest,
                    swarm: swarm.clone(),
                    number: 0,
                    is_ok: true,
                    encoding: payload.encoding.to_owned(),
                    body: payload.bytes,
                })
            });
            let end = Write::Delete { swarm };
            std::iter::once(end).chain(answer).collect()
        }
    }
}

fn kept(swarm: &str, checkpoint: &Checkpoint) -> store::Checkpoint {
    store::Checkpoint {
        number: checkpoint.lines,
        epoch: checkpoint.simulation.epoch,
        step: checkpoint.simulation.state.step,
        body: proto::to_cbor(&durable::snapshot(swarm, checkpoint)),
    }
}

fn fault(fault: StoreFault) -> WriteFault {
    match fault {
        StoreFault::Full => WriteFault::Full,
        other => WriteFault::Failed(other.to_string()),
    }
}

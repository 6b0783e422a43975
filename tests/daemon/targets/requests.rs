//! Requests as they are read, of every verb.

use std::collections::BTreeSet;
use std::fmt::Debug;

use jostle_proto::verbs::{
    AdvanceArgs, BatchArgs, CreateArgs, DeleteArgs, DiscardArgs, ForkArgs, InformArgs, InjectArgs,
    JoinArgs, LeaveArgs, PauseArgs, RemoveArgs, ResetArgs, RestoreArgs, RunArgs, SetArgs, StepArgs,
    UninformArgs, WhenArgs,
};
use jostle_proto::{Arguments, Request, RequestError, SeekArgs};
use serde::de::{DeserializeSeed, Deserializer, Error, MapAccess, SeqAccess};
use serde::{Serialize, de::Visitor};

/// A parsed request is equal after it is written and parsed again; a rejection has a short message.
pub fn check(data: &[u8]) {
    let request = match Request::from_json(data) {
        Ok(request) => request,
        Err(error) => return is_short(&error),
    };
    let written = serde_json::to_vec(&request).expect("a request can be written");
    let again = Request::from_json(&written).expect("what was written can be read");
    let envelope = |request: &Request| {
        let Request {
            request_id,
            client,
            at_step,
            expect_epoch,
            expect_step,
            timeout_secs,
            args: _,
        } = request;
        format!(
            "{request_id:?} {client:?} {at_step:?} {expect_epoch:?} {expect_step:?} {timeout_secs:?}"
        )
    };
    assert_eq!(envelope(&request), envelope(&again));

    arguments_of::<AdvanceArgs>(&request, &again);
    arguments_of::<BatchArgs>(&request, &again);
    arguments_of::<CreateArgs>(&request, &again);
    arguments_of::<DeleteArgs>(&request, &again);
    arguments_of::<DiscardArgs>(&request, &again);
    arguments_of::<ForkArgs>(&request, &again);
    arguments_of::<InformArgs>(&request, &again);
    arguments_of::<InjectArgs>(&request, &again);
    arguments_of::<JoinArgs>(&request, &again);
    arguments_of::<LeaveArgs>(&request, &again);
    arguments_of::<PauseArgs>(&request, &again);
    arguments_of::<RemoveArgs>(&request, &again);
    arguments_of::<ResetArgs>(&request, &again);
    arguments_of::<RestoreArgs>(&request, &again);
    arguments_of::<RunArgs>(&request, &again);
    arguments_of::<SeekArgs>(&request, &again);
    arguments_of::<SetArgs>(&request, &again);
    arguments_of::<StepArgs>(&request, &again);
    arguments_of::<UninformArgs>(&request, &again);
    arguments_of::<WhenArgs>(&request, &again);
}

fn arguments_of<T>(request: &Request, again: &Request)
where
    T: Arguments + Serialize + PartialEq + Debug,
{
    let args: T = match request.args() {
        Ok(args) => args,
        Err(error) => return is_short(&error),
    };
    assert_eq!(again.args::<T>().as_ref(), Ok(&args));
    let written = serde_json::to_vec(&args).expect("arguments can be written");
    let same = Request::from_json(&written)
        .expect("what was written is a request")
        .args::<T>();
    assert_eq!(same.as_ref(), Ok(&args));
    let mut more = serde_json::to_value(&args).expect("arguments can be written");
    more["of_a_later_version"] = true.into();
    let more = Request::from_json(more.to_string().as_bytes()).expect("it is a request");
    assert!(more.args::<T>().is_err(), "{more:?} says what is not known");
    if let Some(text) = &request.args {
        let mut deserializer = serde_json::Deserializer::from_str(text.get());
        let named_once = NamedOnce.deserialize(&mut deserializer);
        assert!(named_once.is_ok(), "{args:?} from {text}: {named_once:?}");
    }
}

fn is_short(error: &RequestError) {
    assert!(error.field.chars().count() <= 101, "{error:?}");
    assert!(error.problem.chars().count() <= 600, "{error:?}");
    assert!(!error.problem.is_empty());
}

/// Reads any JSON in which no object names a field twice, at any depth.
struct NamedOnce;

impl<'de> DeserializeSeed<'de> for NamedOnce {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for NamedOnce {
    type Value = ();

    fn expecting(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str("JSON without a name given twice")
    }

    fn visit_bool<E>(self, _: bool) -> Result<(), E> {
        Ok(())
    }

    fn visit_i64<E>(self, _: i64) -> Result<(), E> {
        Ok(())
    }

    fn visit_u64<E>(self, _: u64) -> Result<(), E> {
        Ok(())
    }

    fn visit_f64<E>(self, _: f64) -> Result<(), E> {
        Ok(())
    }

    fn visit_str<E>(self, _: &str) -> Result<(), E> {
        Ok(())
    }

    fn visit_unit<E>(self) -> Result<(), E> {
        Ok(())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<(), A::Error> {
        while list.next_element_seed(NamedOnce)?.is_some() {}
        Ok(())
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        let mut names = BTreeSet::new();
        while let Some(name) = map.next_key::<String>()? {
            if !names.insert(name.clone()) {
                return Err(A::Error::custom(format!("{name:?} is there twice")));
            }
            map.next_value_seed(NamedOnce)?;
        }
        Ok(())
    }
}

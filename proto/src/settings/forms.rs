//! Settings that JSON writes in more than one way: a number or a pair, a number or a range, a value or "none".

use serde::de::{DeserializeOwned, Error};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::Value;

use super::{KrawtchoukP, OrderRange};

/// `[x, y]`, or one number for both.
pub(super) mod per_axis {
    use super::*;

    pub fn serialize<S: Serializer>(pair: &[f64; 2], serializer: S) -> Result<S::Ok, S::Error> {
        match pair {
            [x, y] if x == y => x.serialize(serializer),
            pair => pair.serialize(serializer),
        }
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[f64; 2], D::Error> {
        match Value::deserialize(deserializer)? {
            Value::Array(pair) => from_value(Value::Array(pair)),
            number => from_value::<f64, D::Error>(number).map(|both| [both; 2]),
        }
    }
}

/// A value, or `"none"`; null is read as none too.
pub(super) mod value_or_none {
    use super::*;

    pub fn serialize<S: Serializer, T: Serialize>(value: &Option<T>, serializer: S) -> Result<S::Ok, S::Error> {
        match value {
            Some(value) => value.serialize(serializer),
            None => "none".serialize(serializer),
        }
    }

    pub fn deserialize<'de, D: Deserializer<'de>, T: DeserializeOwned>(deserializer: D) -> Result<Option<T>, D::Error> {
        match Value::deserialize(deserializer)? {
            Value::Null => Ok(None),
            Value::String(word) if word == "none" => Ok(None),
            value => from_value(value).map(Some),
        }
    }
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct OrderJson {
    min: u16,
    max: u16,
}

impl Serialize for OrderRange {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            OrderRange { min, max } if min == max => min.serialize(serializer),
            OrderRange { min, max } => OrderJson { min: *min, max: *max }.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for OrderRange {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<OrderRange, D::Error> {
        match Value::deserialize(deserializer)? {
            Value::Object(range) => {
                let range: OrderJson = from_value(Value::Object(range))?;
                Ok(OrderRange { min: range.min, max: range.max })
            }
            number => from_value(number).map(|order| OrderRange { min: order, max: order }),
        }
    }
}

impl Serialize for KrawtchoukP {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            KrawtchoukP::Adaptive => "adaptive".serialize(serializer),
            KrawtchoukP::Fixed(p) => per_axis::serialize(p, serializer),
        }
    }
}

impl<'de> Deserialize<'de> for KrawtchoukP {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<KrawtchoukP, D::Error> {
        match Value::deserialize(deserializer)? {
            Value::String(word) if word == "adaptive" => Ok(KrawtchoukP::Adaptive),
            value => per_axis::deserialize(value).map_err(D::Error::custom).map(KrawtchoukP::Fixed),
        }
    }
}

fn from_value<T: DeserializeOwned, E: Error>(value: Value) -> Result<T, E> {
    serde_json::from_value(value).map_err(E::custom)
}

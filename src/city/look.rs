//! The looks that a configuration gives the agents with a concept, or of a kind, in pictures.

use crate::city::AgentKind;
use serde::{Serialize, Serializer};
use std::sync::Arc;

/// The looks of agents in pictures: an icon with a color and a badge, or a drawing with a badge.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Look {
    /// The concept whose icon they have; `None` for the icon of a plain car or pedestrian.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub icon: Option<String>,
    /// The color of the car, or of the pedestrian's clothes, as red, green and blue.
    #[serde(skip_serializing_if = "Option::is_none", serialize_with = "hexadecimal")]
    pub color: Option<[u8; 3]>,
    /// At most [`Look::BADGE_MAX`] letters and digits on a round badge.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub badge: Option<String>,
    /// The text of an SVG drawing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub drawing: Option<Arc<str>>,
}

impl Look {
    /// The maximum number of characters on a badge.
    pub const BADGE_MAX: usize = 2;
}

fn hexadecimal<S: Serializer>(color: &Option<[u8; 3]>, serializer: S) -> Result<S::Ok, S::Error> {
    let [r, g, b] = color.unwrap_or_default();
    serializer.collect_str(&format_args!("#{r:02x}{g:02x}{b:02x}"))
}

/// The looks of the agents with a concept, or of a kind, that a configuration defines.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct OwnLook {
    /// Whether they drive or walk.
    pub of: AgentKind,
    /// The concept, or the name of the kind.
    pub name: String,
    /// Their looks.
    pub look: Look,
}

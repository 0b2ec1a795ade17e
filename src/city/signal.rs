//! Signals: programs of lights at junctions.

use serde::Serialize;

/// The light of a signal for a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Light {
    /// Stop.
    Red,
    /// Stop if you still can.
    Yellow,
    /// Drive.
    Green,
}

impl Light {
    /// All lights.
    pub const ALL: [Light; 3] = [Light::Red, Light::Yellow, Light::Green];

    /// Returns its name in rules, scenes and traces.
    pub const fn name(self) -> &'static str {
        match self {
            Light::Red => "red",
            Light::Yellow => "yellow",
            Light::Green => "green",
        }
    }
}

/// What a signal shows a connection in a phase, as a letter of a map file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Aspect(char);

impl Aspect {
    /// The letters: red, yellow, green that must yield, green, and off.
    pub const LETTERS: &str = "rygGo";

    /// Returns the aspect with a letter.
    pub fn of(letter: char) -> Option<Aspect> {
        Aspect::LETTERS.contains(letter).then_some(Aspect(letter))
    }

    /// Returns its letter.
    pub const fn letter(self) -> char {
        self.0
    }

    /// Returns its light; `None` if the signal is off.
    pub const fn light(self) -> Option<Light> {
        match self.0 {
            'r' => Some(Light::Red),
            'y' => Some(Light::Yellow),
            'g' | 'G' => Some(Light::Green),
            _ => None,
        }
    }
}

/// A phase of a signal.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Phase {
    /// How long it takes, at least 1.
    pub ticks: u32,
    /// The aspect of each of the signal's links.
    #[serde(serialize_with = "letters")]
    pub aspects: Vec<Aspect>,
}

fn letters<S: serde::Serializer>(aspects: &[Aspect], serializer: S) -> Result<S::Ok, S::Error> {
    let letters: String = aspects.iter().map(|aspect| aspect.letter()).collect();
    serializer.serialize_str(&letters)
}

/// A signal, which repeats its phases.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Signal {
    /// Its name.
    pub name: String,
    /// The tick in which its first phase begins.
    pub offset: u32,
    /// The phases, at least one; all have the same number of links.
    pub phases: Vec<Phase>,
}

impl Signal {
    /// The maximum duration of a phase, and the maximum offset, in ticks.
    pub const TICKS_MAX: u32 = 1 << 20;

    /// Returns the number of its links.
    pub fn links(&self) -> usize {
        self.phases.first().map_or(0, |phase| phase.aspects.len())
    }

    /// Returns what it shows a link in a tick.
    pub fn aspect(&self, link: u32, tick: u64) -> Option<Aspect> {
        let cycle: u64 = self.phases.iter().map(|phase| u64::from(phase.ticks)).sum();
        // Before its first phase begins, it is at the end of the last one.
        let begun = cycle - u64::from(self.offset) % cycle.max(1);
        let mut left = (tick % cycle.max(1) + begun) % cycle.max(1);
        for phase in &self.phases {
            let ticks = u64::from(phase.ticks);
            if left < ticks {
                return phase.aspects.get(link as usize).copied();
            }
            left -= ticks;
        }
        None
    }
}

/// A link of a signal, which regulates a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct SignalLink {
    /// The position of the signal.
    pub signal: u32,
    /// The number of the link, from 0.
    pub link: u32,
}

/// Returns the light of several connections together: the one with which a car drives on.
pub(super) fn together(lights: impl Iterator<Item = Light>) -> Option<Light> {
    lights.max_by_key(|light| *light as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_signal_repeats_its_phases_from_its_offset() {
        let phase = |ticks, letters: &str| Phase {
            ticks,
            aspects: letters.chars().filter_map(Aspect::of).collect(),
        };
        let mut signal = Signal {
            name: "S".to_owned(),
            offset: 0,
            phases: vec![phase(3, "Gr"), phase(1, "yr"), phase(2, "rg")],
        };
        let shown = |signal: &Signal, link| -> String {
            (0..9)
                .map(|tick| signal.aspect(link, tick).map_or('-', Aspect::letter))
                .collect()
        };
        assert_eq!([shown(&signal, 0), shown(&signal, 1)], ["GGGyrrGGG", "rrrrggrrr"]);
        signal.offset = 2;
        assert_eq!(shown(&signal, 0), "rrGGGyrrG");
        signal.offset = 14;
        assert_eq!([shown(&signal, 0), shown(&signal, 2)], ["rrGGGyrrG", "---------"]);
        assert!(signal.aspect(1, u64::MAX).is_some());
    }
}

//! The difficulty of pictures, and what depends on it: the version of the drawing code, and the style of icons.
// Decision: docs/decisions/pictures.md#d071

/// The difficulty of recognizing agents in a picture, in percent: 0 is clean.
///
/// Higher values vary colors, light, sharpness, weather and markings more, hide parts of agents and add clutter. From 0
/// to 50, boxes become loose until their sides are independent of the class. From 50 to 100, more and more icons of the
/// test split have a style that the training split lacks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Difficulty(u8);

impl Difficulty {
    /// Only class and instance differ.
    pub const CLEAN: Difficulty = Difficulty(0);
    /// The difficulty from which on boxes are independent of the class.
    pub const HALF: Difficulty = Difficulty(50);
    /// The highest difficulty.
    pub const NOISY: Difficulty = Difficulty(100);

    /// Returns a difficulty from 0 to 100 percent; `None` above.
    pub const fn percent(percent: u8) -> Option<Difficulty> {
        if percent > 100 { None } else { Some(Difficulty(percent)) }
    }

    /// Returns the difficulty in percent, 0 to 100.
    pub const fn as_percent(self) -> u8 {
        self.0
    }

    /// Returns the difficulty as a share, 0..=1.
    pub(super) fn share(self) -> f32 {
        f32::from(self.0) / 100.0
    }
}

/// The version of the drawing code. Data sets record it, so that old ones can be made again.
///
/// At difficulty 0 both versions draw the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum DrawingVersion {
    /// Boxes fit the icons, and all splits have the same style. Pictures have no weather.
    V1,
    /// Difficulty also affects boxes, style and weather.
    #[default]
    V2,
}

impl DrawingVersion {
    /// All versions.
    pub const ALL: [DrawingVersion; 2] = [DrawingVersion::V1, DrawingVersion::V2];

    /// Returns the number: 1 or 2.
    pub const fn number(self) -> u8 {
        match self {
            DrawingVersion::V1 => 1,
            DrawingVersion::V2 => 2,
        }
    }

    /// Returns the version with this number; `None` if there is none.
    pub fn from_number(number: u8) -> Option<DrawingVersion> {
        DrawingVersion::ALL
            .into_iter()
            .find(|version| version.number() == number)
    }
}

/// The style of a generated icon: palette, light and markings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Style {
    /// That of all splits.
    Common,
    /// That of the test split only.
    Test,
}

impl Style {
    /// Returns the first value for the common style, the second one for that of the test split.
    pub(super) const fn choose<T: Copy>(self, common: T, test: T) -> T {
        match self {
            Style::Common => common,
            Style::Test => test,
        }
    }
}

//! The widths of bit sets: the number of words for a number of entities.

/// A supported width of bit sets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Width {
    /// One word.
    One,
    /// Two words.
    Two,
    /// Four words.
    Four,
    /// Sixteen words.
    Sixteen,
    /// Sixty-four words.
    SixtyFour,
}

impl Width {
    /// All widths, narrowest first.
    pub const ALL: [Width; 5] = [Width::One, Width::Two, Width::Four, Width::Sixteen, Width::SixtyFour];

    /// Returns the maximum number of entities in a set of this width.
    pub const fn entities(self) -> usize {
        let words = match self {
            Width::One => 1,
            Width::Two => 2,
            Width::Four => 4,
            Width::Sixteen => 16,
            Width::SixtyFour => 64,
        };
        64 * words
    }

    /// Returns the narrowest width that holds this number of entities.
    pub fn of(entities: usize) -> Option<Width> {
        Width::ALL.into_iter().find(|width| entities <= width.entities())
    }
}

/// `in_words!(width, W => f::<W>())` evaluates the expression with the constant `W` set to the words of a [`Width`].
macro_rules! in_words {
    ($width:expr, $words:ident => $work:expr) => {
        match $width {
            $crate::sim::Width::One => in_words!(@ 1, $words, $work),
            $crate::sim::Width::Two => in_words!(@ 2, $words, $work),
            $crate::sim::Width::Four => in_words!(@ 4, $words, $work),
            $crate::sim::Width::Sixteen => in_words!(@ 16, $words, $work),
            $crate::sim::Width::SixtyFour => in_words!(@ 64, $words, $work),
        }
    };
    (@ $count:literal, $words:ident, $work:expr) => {{
        const $words: usize = $count;
        $work
    }};
}
pub(crate) use in_words;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_narrowest_that_holds_them_is_taken() {
        for width in Width::ALL {
            assert_eq!(64 * in_words!(width, WORDS => WORDS), width.entities());
            assert_eq!(Width::of(width.entities()), Some(width));
            assert!(Width::of(width.entities() + 1) > Some(width) || width == Width::SixtyFour);
        }
        assert_eq!((Width::of(0), Width::of(4097)), (Some(Width::One), None));
    }
}

//! What may be wrong with gratings: the hypotheses under which a reading that fails is looked at.

use super::moments::{Set, of_fibre, of_section};
use crate::tool::sensing::{FIBRES, SECTIONS};

/// Gratings, and all of them.
pub(super) const GRATINGS: usize = FIBRES * SECTIONS;
pub(super) const ALL: Set = (1 << GRATINGS) - 1;

// nine gratings, three fibres, section III, three sections that are warmer than the others, six changes of places
/// The first hypothesis that is a fibre.
pub(super) const FIBRE: usize = GRATINGS;
const WITNESS: usize = FIBRE + FIBRES;
const WARM: usize = WITNESS + 1;
const SWAPS: usize = WARM + SECTIONS;
/// How many there are.
pub(super) const HYPOTHESES: usize = SWAPS + 2 * FIBRES;

/// What is not believed: gratings left out, sections whose warmth is their own (bits), a change of places to undo.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Believed {
    pub(super) bad: Set,
    pub(super) warm: u8,
    pub(super) swap: Option<usize>,
}

impl Believed {
    /// Of a hypothesis alone.
    pub(super) fn of(h: usize) -> Self {
        let (mut bad, mut warm, mut swap) = (0, 0, None);
        match h {
            0..FIBRE => bad = 1 << h,
            FIBRE..WITNESS => bad = of_fibre(h - FIBRE),
            WITNESS => bad = of_section(2),
            WARM..SWAPS => warm = 1 << (h - WARM),
            _ => swap = Some(h - SWAPS),
        }
        Self { bad, warm, swap }
    }

    /// With another beside it; a second change of the same two puts them right.
    pub(super) fn and(self, more: Self) -> Self {
        Self {
            bad: self.bad | more.bad,
            warm: self.warm | more.warm,
            swap: match (self.swap, more.swap) {
                (one, None) => one,
                (one, two) if one == two => None,
                (_, two) => two,
            },
        }
    }

    /// All gratings that are not as they should be.
    pub(super) fn faulty(self) -> Set {
        self.bad | of_swap(self.swap)
    }

    /// Gratings that it costs: a section that is warmer costs none.
    pub(super) fn size(self) -> u32 {
        self.faulty().count_ones()
    }

    /// Whether another costs more and explains all that this does: a larger set around it, or gratings of a section whose
    /// warmth this has to be its own.
    pub(super) fn contained(self, other: Self) -> bool {
        let warm =
            (0..SECTIONS).all(|i| self.warm & (1 << i) == 0 || other.bad & of_section(i) != 0);
        self.swap.is_none() && self.bad & !other.bad == 0 && warm && other.size() > self.size()
    }

    /// Whether it says nothing that is not said already.
    pub(super) fn within(self, other: Self) -> bool {
        self.bad & !other.bad == 0 && self.warm & !other.warm == 0 && self.swap.is_none()
    }
}

/// The two gratings of a change of places: of the section, all but the fibre that stays.
pub(super) fn changed(swap: usize) -> (usize, usize, usize) {
    let (section, stays) = (swap / FIBRES, swap % FIBRES);
    let (a, b) = match stays {
        0 => (1, 2),
        1 => (0, 2),
        _ => (0, 1),
    };
    (section.min(1), a, b)
}

pub(super) fn of_swap(swap: Option<usize>) -> Set {
    swap.map_or(0, |s| {
        let (section, a, b) = changed(s);
        1 << (FIBRES * section + a) | 1 << (FIBRES * section + b)
    })
}

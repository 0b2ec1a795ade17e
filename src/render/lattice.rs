//! Noise that is a function of a place: hashes, and waves between the corners of a lattice. Whole numbers only, so it
//! is the same on all platforms.

/// A noise. Equal places have equal values.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lattice(pub(super) u32);

impl Lattice {
    /// Hashes a place and a layer to 32 bits.
    pub(super) fn hash(self, x: i64, y: i64, layer: u32) -> u32 {
        let mut word = self.0 ^ layer.wrapping_mul(0x9e37_79b9);
        for part in [x as u32, y as u32] {
            word = (word ^ part).wrapping_mul(0x85eb_ca6b);
            word ^= word >> 15;
            word = word.wrapping_mul(0xc2b2_ae35);
            word ^= word >> 13;
        }
        word
    }

    /// Returns a value from -256 to 256 that varies smoothly between the corners of squares of `side` pixels.
    pub(super) fn wave(self, x: i64, y: i64, side: i64, layer: u32) -> i32 {
        let (col, row) = (x.div_euclid(side), y.div_euclid(side));
        let (right, down) = (x.rem_euclid(side), y.rem_euclid(side));
        let corner = |dx: i64, dy: i64| i64::from(self.hash(col + dx, row + dy, layer) & 511) - 256;
        let along = |dy: i64| corner(0, dy) * (side - right) + corner(1, dy) * right;
        ((along(0) * (side - down) + along(1) * down) / (side * side)) as i32
    }
}

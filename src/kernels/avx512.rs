//! The register tile for AVX-512, in assembly.
//!
//! Its sums take 28 of the 32 vector registers. Compilers reorder the loads of such a loop until
//! registers no longer suffice, and then move sums to memory and back at every step, which halves
//! the rate or worse; written out, the loop runs at nine tenths of the machine's peak.

use std::arch::asm;

use super::simd::{MAX_POSITIONS, Run, TILE_VECTORS};

/// One tile: sums over all steps of all runs, stored row by row to the last argument.
///
/// Arguments: runs, their number (not 0), bytes from one step's input to the next, weights, bytes
/// from one step's weights to the next, tile.
pub type Tile = unsafe fn(*const Run, usize, usize, *const f32, usize, *mut f32);

/// Takes up the next run at label 2 and begins its steps at label 3: its address and stride, and
/// the addresses of positions 5 and 10, from which fourteen are within reach.
macro_rules! begin_step {
    () => {
        concat!(
            "2:\n",
            "mov {b0}, [{runs}]\n",
            "mov {s}, [{runs} + 8]\n",
            "mov {n}, [{runs} + 16]\n",
            "lea {s3}, [{s} + 2*{s}]\n",
            "lea {b5}, [{b0} + 4*{s}]\n",
            "add {b5}, {s}\n",
            "lea {b10}, [{b5} + 4*{s}]\n",
            "add {b10}, {s}\n",
            "add {runs}, 24\n",
            "test {n}, {n}\n",
            "jz 4f\n",
            "3:\n"
        )
    };
}

/// Goes on to the next step, and then to the next run.
macro_rules! end_step {
    () => {
        concat!(
            "add {b0}, {x}\n",
            "add {b5}, {x}\n",
            "add {b10}, {x}\n",
            "add {w}, {y}\n",
            "dec {n}\n",
            "jnz 3b\n",
            "4:\n",
            "dec {count}\n",
            "jnz 2b\n"
        )
    };
}

/// `tile!(one vector, two vectors: [sum, second sum, input address] of each position)`.
macro_rules! tile {
    ($one:ident $two:ident: $([$a:tt $b:tt $address:tt])*) => {
        /// One vector of output channels.
        unsafe fn $one(
            runs: *const Run,
            count: usize,
            input_step: usize,
            weights: *const f32,
            weight_step: usize,
            tile: *mut f32,
        ) {
            // SAFETY: the caller promises that every run is readable for all positions and steps,
            // the weights for all steps, and that the tile can be written; all registers that are
            // changed are named.
            unsafe {
                asm!(
                    $(concat!("vpxord ", $a, ", ", $a, ", ", $a),)*
                    begin_step!(),
                    "vmovups zmm28, [{w}]",
                    $(concat!("vfmadd231ps ", $a, ", zmm28, dword ptr [", $address, "]{{1to16}}"),)*
                    end_step!(),
                    $(concat!("vmovups [{tile}], ", $a), "add {tile}, 64",)*
                    runs = inout(reg) runs => _,
                    count = inout(reg) count => _,
                    x = in(reg) input_step,
                    w = inout(reg) weights => _,
                    y = in(reg) weight_step,
                    tile = inout(reg) tile => _,
                    b0 = out(reg) _,
                    b5 = out(reg) _,
                    b10 = out(reg) _,
                    s = out(reg) _,
                    s3 = out(reg) _,
                    n = out(reg) _,
                    $(out($a) _,)*
                    out("zmm28") _,
                    options(nostack),
                );
            }
        }

        /// Two vectors of output channels.
        unsafe fn $two(
            runs: *const Run,
            count: usize,
            input_step: usize,
            weights: *const f32,
            weight_step: usize,
            tile: *mut f32,
        ) {
            // SAFETY: as above.
            unsafe {
                asm!(
                    $(
                        concat!("vpxord ", $a, ", ", $a, ", ", $a),
                        concat!("vpxord ", $b, ", ", $b, ", ", $b),
                    )*
                    begin_step!(),
                    "vmovups zmm28, [{w}]",
                    "vmovups zmm29, [{w} + 64]",
                    $(
                        concat!("vbroadcastss zmm30, dword ptr [", $address, "]"),
                        concat!("vfmadd231ps ", $a, ", zmm28, zmm30"),
                        concat!("vfmadd231ps ", $b, ", zmm29, zmm30"),
                    )*
                    end_step!(),
                    $(
                        concat!("vmovups [{tile}], ", $a),
                        concat!("vmovups [{tile} + 64], ", $b),
                        "add {tile}, 128",
                    )*
                    runs = inout(reg) runs => _,
                    count = inout(reg) count => _,
                    x = in(reg) input_step,
                    w = inout(reg) weights => _,
                    y = in(reg) weight_step,
                    tile = inout(reg) tile => _,
                    b0 = out(reg) _,
                    b5 = out(reg) _,
                    b10 = out(reg) _,
                    s = out(reg) _,
                    s3 = out(reg) _,
                    n = out(reg) _,
                    $(out($a) _, out($b) _,)*
                    out("zmm28") _,
                    out("zmm29") _,
                    out("zmm30") _,
                    options(nostack),
                );
            }
        }
    };
}

/// Tiles of the first position, of the first two, and so on.
macro_rules! prefixes {
    ([$($before:tt)*]) => {};
    ([$($before:tt)*] $one:ident $two:ident $next:tt $($rest:tt)*) => {
        tile!($one $two: $($before)* $next);
        prefixes!([$($before)* $next] $($rest)*);
    };
}

prefixes!([]
    one_1 two_1 ["zmm0" "zmm1" "{b0}"]
    one_2 two_2 ["zmm2" "zmm3" "{b0} + {s}"]
    one_3 two_3 ["zmm4" "zmm5" "{b0} + 2*{s}"]
    one_4 two_4 ["zmm6" "zmm7" "{b0} + {s3}"]
    one_5 two_5 ["zmm8" "zmm9" "{b0} + 4*{s}"]
    one_6 two_6 ["zmm10" "zmm11" "{b5}"]
    one_7 two_7 ["zmm12" "zmm13" "{b5} + {s}"]
    one_8 two_8 ["zmm14" "zmm15" "{b5} + 2*{s}"]
    one_9 two_9 ["zmm16" "zmm17" "{b5} + {s3}"]
    one_10 two_10 ["zmm18" "zmm19" "{b5} + 4*{s}"]
    one_11 two_11 ["zmm20" "zmm21" "{b10}"]
    one_12 two_12 ["zmm22" "zmm23" "{b10} + {s}"]
    one_13 two_13 ["zmm24" "zmm25" "{b10} + 2*{s}"]
    one_14 two_14 ["zmm26" "zmm27" "{b10} + {s3}"]
);

/// Tiles by vectors (one, two) and positions (from one).
pub const TILES: [[Tile; MAX_POSITIONS]; TILE_VECTORS] = [
    [
        one_1, one_2, one_3, one_4, one_5, one_6, one_7, one_8, one_9, one_10, one_11, one_12,
        one_13, one_14,
    ],
    [
        two_1, two_2, two_3, two_4, two_5, two_6, two_7, two_8, two_9, two_10, two_11, two_12,
        two_13, two_14,
    ],
];

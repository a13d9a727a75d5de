//! Sums whose result does not depend on the number of threads.

use rayon::prelude::*;

/// Adds the partitions' gradients, first to last, and returns the sum.
pub(super) fn sum_in_order(partial: Vec<Vec<f32>>, count: usize) -> Vec<f32> {
    let mut partial = partial.into_iter();
    let mut total = partial.next().unwrap_or_else(|| vec![0.0; count]);
    let rest: Vec<Vec<f32>> = partial.collect();
    add_in_order(&mut total, &rest.iter().map(Vec::as_slice).collect::<Vec<_>>());
    total
}

/// Adds the slices to `total`, first to last; only different entries are summed in parallel.
pub(super) fn add_in_order(total: &mut [f32], rest: &[&[f32]]) {
    const CHUNK: usize = 4096;
    total.par_chunks_mut(CHUNK).enumerate().for_each(|(index, total)| {
        for part in rest {
            for (sum, x) in total.iter_mut().zip(&part[index * CHUNK..]) {
                *sum += *x;
            }
        }
    });
}

//! Division of a batch into shuffled minibatches.

use std::ops::Range;

use dappo_sim::rng::Stream;

/// The rows 0..`rows` in random order, in minibatches of about `size`.
pub fn shuffled(rows: usize, size: usize, stream: &mut Stream) -> Vec<Vec<i32>> {
    let mut order: Vec<i32> = (0..rows as i32).collect();
    stream.shuffle(&mut order);
    ranges(rows, size).map(|range| order[range].to_vec()).collect()
}

/// Of the rows 0..`rows`, as many as possible but no more than `most`, with equal gaps.
#[must_use]
pub fn evenly_spaced(rows: usize, most: usize) -> Vec<i32> {
    (0..rows as i32).step_by(rows.div_ceil(most)).collect()
}

/// Cuts 0..`rows` into pieces of nearly equal length, as close to `size` as possible: a short rest would
/// take a step as long as a full minibatch on far noisier gradients.
pub fn ranges(rows: usize, size: usize) -> impl Iterator<Item = Range<usize>> {
    let count = (rows as f64 / size as f64).round().max(1.0) as usize;
    (0..count).map(move |piece| piece * rows / count..(piece + 1) * rows / count)
}

#[cfg(test)]
mod tests {
    use dappo_sim::rng::Purpose;

    use super::*;

    fn order(rows: usize, size: usize, episode: u64) -> Vec<Vec<i32>> {
        shuffled(rows, size, &mut Stream::new(5, episode, Purpose::Shuffle))
    }

    #[test]
    fn every_row_appears_once_in_minibatches_of_nearly_equal_size() {
        for (rows, size, expected) in
            [(10, 3, vec![3, 3, 4]), (10, 100, vec![10]), (11, 4, vec![3, 4, 4]), (1, 1, vec![1])]
        {
            let minibatches = order(rows, size, 0);
            assert_eq!(minibatches.iter().map(Vec::len).collect::<Vec<_>>(), expected);
            let mut all = minibatches.concat();
            all.sort_unstable();
            assert_eq!(all, (0..rows as i32).collect::<Vec<_>>());
        }
    }

    #[test]
    fn evenly_spaced_rows_keep_equal_gaps_and_the_limit() {
        for (rows, most, expected) in [
            (7, 7, vec![0, 1, 2, 3, 4, 5, 6]),
            (8, 7, vec![0, 2, 4, 6]),
            (9, 3, vec![0, 3, 6]),
            (1, 5, vec![0]),
        ] {
            assert_eq!(evenly_spaced(rows, most), expected);
        }
    }

    #[test]
    fn the_order_is_a_function_of_the_stream() {
        assert_eq!(order(100, 10, 0), order(100, 10, 0));
        assert_ne!(order(100, 10, 0), order(100, 10, 1));
        assert_ne!(order(100, 100, 0)[0], (0..100).collect::<Vec<i32>>());
    }
}

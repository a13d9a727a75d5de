//! What holds for every division of rollouts into shards, valid or not.

use dappo_diagnose::dataset::Shard;
use proptest::prelude::*;

use crate::cases::cases;

proptest! {
    #![proptest_config(cases(200))]

    #[test]
    fn shards_cut_any_number_of_rollouts_without_gap_or_overlap(count in 1_usize..50, rollouts in 0_usize..10_000) {
        let mut next = 0;
        for index in 0..count {
            let range = Shard::parse(&format!("{index}/{count}")).unwrap().range(rollouts);
            prop_assert_eq!(range.start, next);
            next = range.end;
        }
        prop_assert_eq!(next, rollouts);
    }

    #[test]
    fn a_shard_of_any_text_and_size_lies_within_the_rollouts(
        index in any::<usize>(), count in any::<usize>(), rollouts in any::<usize>()
    ) {
        if let Ok(shard) = Shard::parse(&format!("{index}/{count}")) {
            let range = shard.range(rollouts);
            prop_assert!(range.start <= range.end && range.end <= rollouts);
        }
    }
}

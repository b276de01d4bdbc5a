//! Whose task it is: what is known of its secret. The worker that made the secret knows it; one that took the task over knows its hash,
//! until somebody presents the secret itself.

use std::sync::OnceLock;

use domvs_proto::frame::{Secret, SecretHash};

/// Tells a task's secret from any other.
pub(crate) struct SecretCheck {
    hash: SecretHash,
    known: OnceLock<Secret>,
}

impl SecretCheck {
    pub(crate) fn of(secret: Secret) -> SecretCheck {
        SecretCheck { hash: secret.hash(), known: OnceLock::from(secret) }
    }

    pub(crate) fn by_hash(hash: SecretHash) -> SecretCheck {
        SecretCheck { hash, known: OnceLock::new() }
    }

    /// What may be told to others.
    pub(crate) fn hash(&self) -> SecretHash {
        self.hash
    }

    /// Whether `secret` is the task's. The first right one is remembered, so that the hash is made once.
    pub(crate) fn admits(&self, secret: &Secret) -> bool {
        if let Some(known) = self.known.get() {
            return known == secret;
        }
        let right = self.hash.is_of(secret);
        if right {
            // Another thread may have been first; it had the same secret.
            let _ = self.known.set(secret.clone());
        }
        right
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_secret_is_known_by_its_hash_and_a_wrong_one_before_it_changes_nothing() {
        let (right, wrong) = (Secret::new([1; 16]), Secret::new([2; 16]));
        for check in [SecretCheck::of(right.clone()), SecretCheck::by_hash(right.hash())] {
            for _ in 0..2 {
                assert!(!check.admits(&wrong));
                assert!(check.admits(&right));
            }
            assert_eq!(check.hash(), right.hash());
        }
    }
}

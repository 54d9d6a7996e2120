-- The workers of a key that registered last decide whether its next one is quarantined.
CREATE INDEX worker_by_registration ON worker (owner, registered_ms);

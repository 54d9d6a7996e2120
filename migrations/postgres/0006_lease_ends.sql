-- When each lease ended, and how long it had lasted then: see migrations/0019_lease_ends.sql.

ALTER TABLE lease ADD COLUMN ended_at_ms BIGINT;
ALTER TABLE lease ADD COLUMN took_ms BIGINT CHECK (took_ms >= 0);

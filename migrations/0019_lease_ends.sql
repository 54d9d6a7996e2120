-- When each lease ended, by the wall clock, and how long it had lasted then: who rendered which tile, and when.

ALTER TABLE lease ADD COLUMN ended_at_ms INTEGER;
ALTER TABLE lease ADD COLUMN took_ms INTEGER CHECK (took_ms >= 0);

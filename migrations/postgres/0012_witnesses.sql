-- Witnesses against tiles and results: see migrations/0025_witnesses.sql.

ALTER TABLE tile ADD COLUMN blamed_by TEXT;
ALTER TABLE verification ADD COLUMN failures BIGINT NOT NULL DEFAULT 0 CHECK (failures >= 0);
ALTER TABLE verification ADD COLUMN failed_by TEXT;

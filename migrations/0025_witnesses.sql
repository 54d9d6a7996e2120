-- Who speaks against a tile or a result: workers of one key are one witness.

-- The owner of all leases of the tile that ended with an error or were lost; empty if there are several owners, or the pool
-- is one of them.
ALTER TABLE tile ADD COLUMN blamed_by TEXT;

-- Attempts at the verification that failed, and the last verifier that failed.
ALTER TABLE verification ADD COLUMN failures INTEGER NOT NULL DEFAULT 0 CHECK (failures >= 0);
ALTER TABLE verification ADD COLUMN failed_by TEXT;

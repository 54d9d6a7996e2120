-- Rows that keep one caller from harming others: the audit log's kinds, the owner of a worker, limits of a key.

-- What a change did is never pruned for what was refused, nor an administrator's changes for those of jobs.
ALTER TABLE audit ADD COLUMN kind TEXT NOT NULL DEFAULT 'work' CHECK (kind IN ('admin', 'work', 'refused'));

UPDATE audit SET kind = 'admin' WHERE route NOT LIKE '/v1/jobs%' AND route NOT LIKE '/v1/worker/%';
UPDATE audit SET kind = 'refused' WHERE code IS NOT NULL;

CREATE INDEX audit_by_kind ON audit (kind, number);

-- Who registered a worker, and alone speaks for it: a key's id, `pool`, or `local` without keys. A worker registered by an
-- earlier release belongs to the first caller that syncs for it.
ALTER TABLE worker ADD COLUMN owner TEXT;

CREATE INDEX worker_by_owner ON worker (owner) WHERE state <> 'gone';

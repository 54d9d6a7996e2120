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

-- The highest priority that a key's jobs may ask for; null means the default.
ALTER TABLE key ADD COLUMN max_priority INTEGER CHECK (max_priority BETWEEN -100 AND 100);

-- Whose a delivery is and where it goes: attempts are shared fairly among submitters and receivers.
ALTER TABLE webhook ADD COLUMN target TEXT NOT NULL DEFAULT '';
UPDATE webhook SET target = url;
ALTER TABLE delivery ADD COLUMN submitter TEXT NOT NULL DEFAULT '';
ALTER TABLE delivery ADD COLUMN target TEXT NOT NULL DEFAULT '';
UPDATE delivery SET target = url WHERE state = 'pending';

DROP INDEX delivery_due;
CREATE INDEX delivery_due ON delivery (next_at_ms, submitter, target) WHERE state = 'pending';

DROP TRIGGER webhook_due;
CREATE TRIGGER webhook_due AFTER INSERT ON outbox WHEN new.kind IN ('state', 'frame') BEGIN
    INSERT INTO delivery (id, event, url, target, submitter, job, name, body, state, next_at_ms)
    SELECT 'msg_' || lower(hex(randomblob(16))),
           iif(new.kind = 'frame', 'frame.stored', 'job.' || new.state), webhook.url, webhook.target, job.submitter,
           job.id, job.name, new.body, 'pending', 0
    FROM webhook CROSS JOIN job ON job.number = webhook.job
    WHERE webhook.job = new.job
      AND instr(webhook.events, ',' || iif(new.kind = 'frame', 'frame.stored', 'job.' || new.state) || ',') > 0;
END;

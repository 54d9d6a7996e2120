-- Who wants to be told of a job, and what was told: a delivery is made by the change it tells of, in its transaction.

CREATE TABLE webhook (
    number INTEGER PRIMARY KEY,
    job    INTEGER NOT NULL REFERENCES job (number) ON DELETE CASCADE,
    url    TEXT NOT NULL,
    -- Names of events, each between commas.
    events TEXT NOT NULL CHECK (events LIKE ',%,')
) STRICT;

CREATE INDEX webhook_by_job ON webhook (job);

-- It carries all that its message says, so that it outlives its job, and says the same each time.
CREATE TABLE delivery (
    number         INTEGER PRIMARY KEY AUTOINCREMENT,
    id             TEXT NOT NULL UNIQUE,
    event          TEXT NOT NULL,
    url            TEXT NOT NULL,
    job            TEXT NOT NULL,
    name           TEXT NOT NULL,
    body           TEXT NOT NULL,
    state          TEXT NOT NULL CHECK (state IN ('pending', 'delivered', 'failed')),
    attempts       INTEGER NOT NULL DEFAULT 0 CHECK (attempts >= 0),
    next_at_ms     INTEGER,
    status         INTEGER,
    error          TEXT,
    finished_at_ms INTEGER,
    CHECK ((next_at_ms IS NOT NULL) = (state = 'pending')),
    CHECK ((finished_at_ms IS NOT NULL) = (state <> 'pending'))
) STRICT;

CREATE INDEX delivery_due ON delivery (next_at_ms) WHERE state = 'pending';
CREATE INDEX delivery_by_job ON delivery (job);
CREATE INDEX delivery_by_end ON delivery (finished_at_ms) WHERE finished_at_ms IS NOT NULL;

-- next_at_ms 0: at once.
CREATE TRIGGER webhook_due AFTER INSERT ON outbox WHEN new.kind IN ('state', 'frame') BEGIN
    INSERT INTO delivery (id, event, url, job, name, body, state, next_at_ms)
    SELECT 'msg_' || lower(hex(randomblob(16))),
           iif(new.kind = 'frame', 'frame.stored', 'job.' || new.state), webhook.url, job.id, job.name, new.body,
           'pending', 0
    FROM webhook CROSS JOIN job ON job.number = webhook.job
    WHERE webhook.job = new.job
      AND instr(webhook.events, ',' || iif(new.kind = 'frame', 'frame.stored', 'job.' || new.state) || ',') > 0;
END;

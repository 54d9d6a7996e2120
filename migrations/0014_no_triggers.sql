-- What follows from a change of a job, tile, frame or lease is written by the server, in the change's transaction.

DROP TRIGGER job_accepted;
DROP TRIGGER job_moved;
DROP TRIGGER job_progressed;
DROP TRIGGER tile_rendered;
DROP TRIGGER frame_stored;
DROP TRIGGER frame_reused;
DROP TRIGGER webhook_due;
DROP TRIGGER backlog_grows;
DROP TRIGGER backlog_grows_again;
DROP TRIGGER backlog_shrinks;
DROP TRIGGER backlog_forgets;
DROP TRIGGER job_takes_part;
DROP TRIGGER job_changes_part;
DROP TRIGGER job_takes_no_part;
DROP TRIGGER charge_corrected;
DROP TRIGGER job_forgets_speeds;

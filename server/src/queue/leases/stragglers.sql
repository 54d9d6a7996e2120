SELECT tile.job, tile.frame, tile.kind, old.worker, old.granted_ms
 FROM (SELECT tile, worker, granted_ms FROM lease WHERE ended IS NULL ORDER BY granted_ms LIMIT ?6) AS old
 @join tile ON tile.id = old.tile
 @join job ON job.number = tile.job
 WHERE old.worker <> ?2 AND job.paused = 0 AND job.finished_at_ms IS NULL AND (tile.kind = 'stitch' OR job.nodes <= ?4)
   AND (tile.avoid IS NULL OR tile.avoid <> ?2)
   AND NOT EXISTS (SELECT 1 FROM strike WHERE strike.job = tile.job AND strike.worker = ?2 AND until_ms > ?1)
   AND (SELECT count(*) FROM lease WHERE lease.tile = tile.id AND lease.ended IS NULL) = 1
 ORDER BY old.granted_ms

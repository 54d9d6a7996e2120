SELECT tile.job, tile.frame, tile.kind, old.worker, old.granted_ms
 FROM (SELECT tile, worker, granted_ms FROM lease WHERE ended IS NULL ORDER BY granted_ms LIMIT ?6) AS old
 @join tile ON tile.id = old.tile
 @join job ON job.number = tile.job
 WHERE old.worker <> ?2 AND job.paused = 0 AND job.finished_at_ms IS NULL AND (tile.kind = 'stitch' OR job.nodes <= ?4)
   AND (tile.avoid IS NULL OR tile.avoid <> ?2)
   AND NOT EXISTS (SELECT 1 FROM strike WHERE strike.job = tile.job AND strike.worker = ?2 AND until_ms > ?1)
   AND (SELECT count(*) FROM lease AS live WHERE live.tile = tile.id AND live.ended IS NULL) <=
       CASE WHEN EXISTS (
           SELECT 1 FROM lease AS live @join worker AS holder ON holder.id = live.worker
           WHERE live.tile = tile.id AND live.ended IS NULL
             AND (holder.pool = 1 OR holder.owner IS NOT DISTINCT FROM (SELECT owner FROM worker WHERE id = ?2)))
       THEN 1 ELSE 2 END
 ORDER BY old.granted_ms

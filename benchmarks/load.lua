-- Sends the request bodies of a folder one after the other, and counts what is not a mesh.
-- Arguments after "--": the folder, the number of bodies, their content type, the path.

local bodies, path, turn, threads = {}, nil, 0, {}

function setup(thread)
   table.insert(threads, thread)
   thread:set("number", #threads)
end

function init(arguments)
   local folder, count = arguments[1], tonumber(arguments[2])
   path = arguments[4]
   wrk.method = "POST"
   wrk.headers["Content-Type"] = arguments[3]
   wrk.headers["Prefer"] = "wait=30"
   for i = 0, count - 1 do
      local file = assert(io.open(folder .. "/" .. i, "rb"))
      bodies[i] = file:read("*a")
      file:close()
   end
   turn, made, refused = number * 37, 0, 0
end

function request()
   turn = turn + 1
   return wrk.format(nil, path, nil, bodies[turn % (#bodies + 1)])
end

function response(status)
   if status == 201 then made = made + 1 else refused = refused + 1 end
end

function done(summary, latency, requests)
   local made, refused = 0, 0
   for _, thread in ipairs(threads) do
      made, refused = made + thread:get("made"), refused + thread:get("refused")
   end
   local failed = summary.errors.connect + summary.errors.read + summary.errors.write + summary.errors.timeout
   io.write(string.format(
      '{"made": %d, "refused": %d, "failed": %d, "seconds": %.6f, "median": %.6f, "p99": %.6f}\n',
      made, refused, failed, summary.duration / 1e6, latency:percentile(50) / 1e3, latency:percentile(99) / 1e3))
end

# Runs the cases of a file, a line each: name, address, action, spec, between tabs. Prints a line for each.
include(ARGS[1])

# The domain of the cases on blocks.
const BEND = (
    kind = "blocks",
    vertices = (a = [0, 0], b = [1, 0], c = [2, 0], d = [0, 1], e = [1, 1], f = [2, 1]),
    blocks = [
        (corners = ["a", "b", "e", "d"], cells = [4, 4]),
        (corners = ["b", "c", "f", "e"], cells = [4, nothing]),
    ],
)

"""A sum that changes with each value and with their order, along the rows of a matrix."""
weighed(values::AbstractMatrix) = weighed(vec(permutedims(values)))
weighed(values::AbstractVector) = sum(k * Float64(value) for (k, value) in enumerate(values))

function numbers_of(mesh, fields...)
    node = invperm(vec(permutedims(LinearIndices(mesh.x))))
    cells = [node[index] - 1 for index in permutedims(mesh.cells)]
    return join((length(mesh.x), size(cells)..., map(weighed, (mesh.x, mesh.y, cells, fields...))...), ' ')
end

function result_of(url, action, spec)
    if action == "step"
        sequence = Equimesh.start(url, spec)
        x, y = sequence.mesh.x, sequence.mesh.y
        mesh, carried = Equimesh.step!(sequence, x .^ 3 .+ y, (T = x .+ 2 .* y,))
        close(sequence)
        return numbers_of(mesh, carried.T)
    end
    mesh = Equimesh.generate(url, spec)
    action == "generate" && return numbers_of(mesh)
    u = mesh.x .^ 3 .+ mesh.y
    if action == "diverge"
        u[1, 2:3] .= (NaN, -Inf)
    end
    more = mesh.x isa Matrix ? NamedTuple() : (domain = BEND,)
    return numbers_of(Equimesh.next_mesh(url, mesh, u; more...))
end

for line in eachline(ARGS[2])
    name, url, action, spec = split(line, '\t')
    said = try
        result_of(url, action, spec)
    catch failure
        failure isa Equimesh.Failure || rethrow()
        failure.message
    end
    println(name, '\t', said)
end

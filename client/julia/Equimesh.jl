"""
Meshes of an equimesh service, for Julia 1.6 and later. It needs no package, only Julia's standard library.

    include("Equimesh.jl")
    mesh = Equimesh.generate(url, spec)
    mesh = Equimesh.next_mesh(url, mesh, u)            # for a solution with the values u
    sequence = Equimesh.start(url, spec)               # sequence.mesh is its first mesh
    mesh, carried = Equimesh.step!(sequence, u, (T = temperature,))
    close(sequence)

`spec` is JSON text, or a NamedTuple or Dict, as in the reference of the HTTP interface. A failure is an
`Equimesh.Failure` with one sentence, that of the service where it answered. The API key is that of the environment
variable EQUIMESH_KEY.
"""
module Equimesh

using Downloads
using Random: RandomDevice

"""
A mesh. `x`, `y` and `u`, `nothing` where the mesh has none, are matrices of size `(n_xi, n_eta)` for a grid, vectors
for blocks. Each column of `cells` has the nodes of a cell, counter-clockwise, as indices of `x`: `x[cells[:, 1]]`.
"""
struct Mesh
    x::Array{Float64}
    y::Array{Float64}
    u::Union{Nothing,Array{Float64}}
    cells::Matrix{Int}
end

"""A mesh that follows a solution in time: `mesh` is the newest one, `step` the number of the next one."""
mutable struct Sequence
    url::String
    address::String
    step::Int
    deadline::Float64
    mesh::Mesh
end

struct Failure <: Exception
    message::String
end

Base.showerror(io::IO, failure::Failure) = print(io, failure.message)

"""The mesh of a `spec`, once it is finished; `deadline` is in seconds."""
function generate(url::AbstractString, spec; deadline::Real = 600)
    file, _ = send_until_done(url, "/v1/meshes?format=npz", json(spec), deadline)
    return mesh_of(arrays_of(file))
end

"""
The next mesh for a solution whose values at the nodes of `mesh` are `u`, for the `norm` "l2" or "h1". Further members
of the spec are keywords: `domain = ...` of the mesh.
"""
function next_mesh(url::AbstractString, mesh::Mesh, u::AbstractArray; norm = "l2", deadline::Real = 600, more...)
    size(u) == size(mesh.x) || throw(Failure("u has the size $(size(u)), and the mesh $(size(mesh.x))"))
    if mesh.x isa Matrix
        values = (nodal = (x = mesh.x, y = mesh.y, values = u),)
        grid = (grid = (n_xi = size(u, 1), n_eta = size(u, 2)),)
    else
        values = (block_nodes = (nodes = hcat(mesh.x, mesh.y), values = u),)
        grid = NamedTuple()
    end
    monitor = (kind = "nodal_solution", norm = norm, u = values)
    return generate(url, merge((monitor = monitor,), grid, (; more...)); deadline = deadline)
end

"""A sequence with its first mesh; each call waits at most `deadline` seconds."""
function start(url::AbstractString, spec; deadline::Real = 600)
    file, address = send_until_done(url, "/v1/sequences?format=npz", json(spec), deadline)
    return Sequence(url, address, 0, deadline, mesh_of(arrays_of(file)))
end

"""
The next mesh of a sequence, adapted to `u` at the nodes of the mesh before, and the `fields`, a NamedTuple of arrays,
carried to its nodes.
"""
function step!(sequence::Sequence, u::AbstractArray, fields::NamedTuple = NamedTuple())
    sent = (step = sequence.step, u = (nodes = as_rows(u),), fields = map(as_rows, fields))
    file, _ = send_until_done(sequence.url, sequence.address * "/steps?format=npz", json(sent), sequence.deadline)
    arrays = arrays_of(file)
    mesh = mesh_of(arrays)
    carried = NamedTuple{keys(fields)}(Tuple(arrays[String(name)] for name in keys(fields)))
    sequence.mesh = mesh
    sequence.step += 1
    return mesh, carried
end

"""Delete the sequence and its meshes at the service."""
function Base.close(sequence::Sequence)
    send_once(sequence.url, "DELETE", sequence.address, nothing, "end", sequence.deadline)
    return nothing
end

# ---- requests ----

"""Send a request until its mesh is finished: repeated with its key it waits on, and adds no work."""
function send_until_done(url, path, body, deadline)
    once = string("j-", getpid(), "-", time_ns(), "-", rand(RandomDevice(), UInt64))
    finish = time() + deadline
    while time() < finish
        status, file, address = send_once(url, "POST", path, body, once, finish - time())
        status == 202 || return file, address
        sleep(0.5)
    end
    throw(Failure("the mesh is not finished after $deadline seconds: wait longer by the keyword deadline"))
end

function send_once(url, method, path, body, once, seconds)
    place = rstrip(url, '/')
    headers = Pair{String,Union{Nothing,String}}[
        "Content-Type" => "application/json",
        "Prefer" => "wait=30",
        "Idempotency-Key" => once,
        "Expect" => nothing,
    ]
    key = get(ENV, "EQUIMESH_KEY", "")
    isempty(key) || push!(headers, "Authorization" => "Bearer " * key)
    input = body === nothing ? nothing : IOBuffer(body)
    output = IOBuffer()
    answer = Downloads.request(
        string(place, path);
        method = method,
        headers = headers,
        input = input,
        output = output,
        timeout = max(seconds, 0.001),
        throw = false,
    )
    if answer isa Downloads.RequestError
        said = isempty(answer.message) ? "error $(answer.code) of libcurl" : answer.message
        hint = "start it with equimesh serve, or give its address"
        throw(Failure("the service at $place does not answer ($said): $hint"))
    end
    file = take!(output)
    answer.status < 300 || throw(Failure(sentence(file, answer.status, place)))
    address = ""
    for (name, value) in answer.headers
        lowercase(name) == "location" && (address = value)
    end
    return answer.status, file, address
end

const ESCAPES = Dict("n" => "\n", "r" => "\r", "t" => "\t", "b" => "\b", "f" => "\f")

"""The detail of a problem, else its title."""
function sentence(answer, status, place)
    text = String(answer)
    for member in ("detail", "title")
        found = isvalid(text) ? match(Regex("\"$member\"\\s*:\\s*\"((?:[^\"\\\\]|\\\\.)+)\""), text) : nothing
        found === nothing || return replace(String(found[1]), r"(\\u[0-9a-fA-F]{4})+|\\." => unescaped)
    end
    return "the service answered with HTTP $status and no reason: is $place the address of equimesh?"
end

function unescaped(escape)
    units = [parse(UInt16, found[1]; base = 16) for found in eachmatch(r"\\u(.{4})", escape)]
    isempty(units) || return transcode(String, units)
    return get(ESCAPES, String(escape[2:end]), String(escape[2:end]))
end

# ---- JSON ----

json(text::AbstractString) = String(text)
json(spec) = sprint(write_json, spec)

function write_json(io::IO, members::Union{NamedTuple,AbstractDict})
    separator = '{'
    for (name, value) in pairs(members)
        print(io, separator)
        write_json(io, string(name))
        print(io, ':')
        write_json(io, value)
        separator = ','
    end
    print(io, separator == '{' ? "{}" : "}")
end

function write_json(io::IO, values::Union{Tuple,AbstractVector})
    print(io, '[')
    for (k, value) in enumerate(values)
        k == 1 || print(io, ',')
        write_json(io, value)
    end
    print(io, ']')
end

write_json(io::IO, rows::AbstractMatrix) = write_json(io, [view(rows, i, :) for i in axes(rows, 1)])
write_json(io::IO, value::Integer) = print(io, value)
write_json(io::IO, ::Nothing) = print(io, "null")
write_json(io::IO, name::Symbol) = write_json(io, string(name))

# A number that is not finite has the name that the service knows, which then says where it is.
function write_json(io::IO, value::Real)
    number = Float64(value)
    print(io, isnan(number) ? "NaN" : isinf(number) ? (number > 0 ? "Infinity" : "-Infinity") : number)
end

function write_json(io::IO, text::AbstractString)
    print(io, '"')
    for character in text
        if character == '"' || character == '\\'
            print(io, '\\', character)
        elseif character < ' '
            print(io, "\\u", string(UInt32(character); base = 16, pad = 4))
        else
            print(io, character)
        end
    end
    print(io, '"')
end

# Values at the nodes of blocks are rows of one value.
as_rows(values::AbstractMatrix) = values
as_rows(values::AbstractVector) = reshape(values, :, 1)

# ---- the arrays of an npz file, a zip without compression ----

"""The little-endian number of `count` bytes that begins `offset` bytes after the start of the file."""
number(bytes, offset, count) = sum(Int(bytes[offset + k]) << (8 * (k - 1)) for k in 1:count)

function arrays_of(bytes::Vector{UInt8})
    arrays = Dict{String,Array}()
    last_record = length(bytes) - 22
    while last_record >= 0 && number(bytes, last_record, 4) != 0x06054b50
        last_record -= 1
    end
    last_record >= 0 || return arrays
    entry = number(bytes, last_record + 16, 4)
    for _ in 1:number(bytes, last_record + 10, 2)
        compression, size_of_name = number(bytes, entry + 10, 2), number(bytes, entry + 28, 2)
        name = String(bytes[entry + 47:entry + 46 + size_of_name])
        file = number(bytes, entry + 42, 4)
        entry += 46 + size_of_name + number(bytes, entry + 30, 2) + number(bytes, entry + 32, 2)
        compression == 0 && endswith(name, ".npy") || continue
        values = array_at(bytes, file + 30 + number(bytes, file + 26, 2) + number(bytes, file + 28, 2))
        values === nothing || (arrays[chop(name; tail = 4)] = values)
    end
    return arrays
end

"""The array of 8-byte numbers in npy format at an offset, or `nothing` for other types; a matrix has its rows as rows."""
function array_at(bytes, offset)
    wide = bytes[offset + 7] == 1 ? 2 : 4
    first_value = offset + 8 + wide + number(bytes, offset + 8, wide)
    header = String(bytes[offset + 9 + wide:first_value])
    type = occursin("'<f8'", header) ? Float64 : occursin("'<i8'", header) ? Int64 : nothing
    shape = match(r"'shape': \(([^)]*)\)", header)
    (type === nothing || shape === nothing || occursin("'fortran_order': True", header)) && return nothing
    sizes = [parse(Int, found.match) for found in eachmatch(r"\d+", shape[1])]
    values = collect(reinterpret(type, bytes[first_value + 1:first_value + 8 * prod(sizes)]))
    return length(sizes) == 2 ? permutedims(reshape(values, sizes[2], sizes[1])) : values
end

function mesh_of(arrays)
    if !all(name -> haskey(arrays, name), ("x", "y", "cells"))
        throw(Failure("the mesh file of the service cannot be read: is this client older than the service?"))
    end
    x = arrays["x"]
    # The service numbers the nodes of a grid along its rows, Julia the elements of a matrix along its columns.
    index = vec(permutedims(LinearIndices(x)))
    return Mesh(x, arrays["y"], get(arrays, "u", nothing), [index[node + 1] for node in permutedims(arrays["cells"])])
end

end

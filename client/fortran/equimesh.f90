!> Meshes of an equimesh service, for Fortran 2003 and later, by the client for C.
!>
!> Every procedure that talks to the service has an `error`, which is not allocated where nothing failed, and else is one
!> sentence, that of the service where it answered.
module equimesh
  use, intrinsic :: iso_c_binding
  implicit none
  private
  public :: equimesh_service, equimesh_mesh, equimesh_sequence
  public :: equimesh_open, equimesh_close, equimesh_generate, equimesh_round
  public :: equimesh_begin, equimesh_step, equimesh_end

  !> A connection to a service.
  type :: equimesh_service
    private
    type(c_ptr) :: handle = c_null_ptr
  end type

  !> A mesh. Of a grid, node (i, j) has the number (i - 1) * n_eta + j; n_xi and n_eta are 0 for blocks.
  type :: equimesh_mesh
    integer(c_int64_t) :: n_xi = 0, n_eta = 0
    real(c_double), allocatable :: x(:), y(:)        !< coordinates of the nodes
    real(c_double), allocatable :: u(:)              !< u at the nodes; not allocated where there is none
    integer(c_int64_t), allocatable :: cells(:, :)   !< cells(:, k): the nodes of cell k from 1, counter-clockwise
  end type

  !> A mesh that follows a solution in time.
  type, bind(c) :: equimesh_sequence
    character(kind=c_char) :: address(256)
    integer(c_int64_t) :: step
  end type

  type, bind(c) :: c_mesh
    integer(c_int64_t) :: points = 0, cells = 0, corners = 0, n_xi = 0, n_eta = 0
    type(c_ptr) :: x = c_null_ptr, y = c_null_ptr, u = c_null_ptr, cell = c_null_ptr
  end type

  interface
    function c_open(url, key) bind(c, name='equimesh_open') result(handle)
      import :: c_ptr, c_char
      character(kind=c_char), intent(in) :: url(*), key(*)
      type(c_ptr) :: handle
    end function
    subroutine c_close(handle) bind(c, name='equimesh_close')
      import :: c_ptr
      type(c_ptr), value :: handle
    end subroutine
    function c_error(handle) bind(c, name='equimesh_error') result(text)
      import :: c_ptr
      type(c_ptr), value :: handle
      type(c_ptr) :: text
    end function
    function c_generate(handle, spec, mesh) bind(c, name='equimesh_generate') result(failed)
      import :: c_ptr, c_char, c_int, c_mesh
      type(c_ptr), value :: handle
      character(kind=c_char), intent(in) :: spec(*)
      type(c_mesh), intent(inout) :: mesh
      integer(c_int) :: failed
    end function
    function c_round(handle, u, norm, more, mesh) bind(c, name='equimesh_round') result(failed)
      import :: c_ptr, c_char, c_int, c_double, c_mesh
      type(c_ptr), value :: handle
      real(c_double), intent(in) :: u(*)
      character(kind=c_char), intent(in) :: norm(*), more(*)
      type(c_mesh), intent(inout) :: mesh
      integer(c_int) :: failed
    end function
    function c_begin(handle, spec, sequence, mesh) bind(c, name='equimesh_begin') result(failed)
      import :: c_ptr, c_char, c_int, c_mesh, equimesh_sequence
      type(c_ptr), value :: handle
      character(kind=c_char), intent(in) :: spec(*)
      type(equimesh_sequence), intent(inout) :: sequence
      type(c_mesh), intent(inout) :: mesh
      integer(c_int) :: failed
    end function
    function c_step(handle, sequence, u, count, names, fields, mesh) bind(c, name='equimesh_step') result(failed)
      import :: c_ptr, c_int, c_double, c_mesh, equimesh_sequence
      type(c_ptr), value :: handle
      type(equimesh_sequence), intent(inout) :: sequence
      real(c_double), intent(in) :: u(*)
      integer(c_int), value :: count
      type(c_ptr), intent(in) :: names(*), fields(*)
      type(c_mesh), intent(inout) :: mesh
      integer(c_int) :: failed
    end function
    function c_end(handle, sequence) bind(c, name='equimesh_end') result(failed)
      import :: c_ptr, c_int, equimesh_sequence
      type(c_ptr), value :: handle
      type(equimesh_sequence), intent(inout) :: sequence
      integer(c_int) :: failed
    end function
    subroutine c_free(mesh) bind(c, name='equimesh_free')
      import :: c_mesh
      type(c_mesh), intent(inout) :: mesh
    end subroutine
    function c_length(text) bind(c, name='strlen') result(length)
      import :: c_ptr, c_size_t
      type(c_ptr), value :: text
      integer(c_size_t) :: length
    end function
  end interface

contains

  !> Connect to the service at `url`, such as 'http://127.0.0.1:8000', with an API `key` where it needs one.
  subroutine equimesh_open(service, url, key)
    type(equimesh_service), intent(out) :: service
    character(*), intent(in) :: url
    character(*), intent(in), optional :: key
    if (present(key)) then
      service%handle = c_open(trim(url) // c_null_char, trim(key) // c_null_char)
    else
      service%handle = c_open(trim(url) // c_null_char, c_null_char)
    end if
    if (.not. c_associated(service%handle)) error stop 'equimesh_open: there is no memory'
  end subroutine

  subroutine equimesh_close(service)
    type(equimesh_service), intent(inout) :: service
    call c_close(service%handle)
    service%handle = c_null_ptr
  end subroutine

  !> The mesh of a spec, once it is finished. `spec` is JSON, as in the reference of the HTTP interface.
  subroutine equimesh_generate(service, spec, mesh, error)
    type(equimesh_service), intent(in) :: service
    character(*), intent(in) :: spec
    type(equimesh_mesh), intent(inout) :: mesh
    character(:), allocatable, intent(out) :: error
    type(c_mesh) :: found
    integer(c_int) :: failed
    failed = c_generate(service%handle, spec // c_null_char, found)
    call finish(service, failed, found, mesh, error)
  end subroutine

  !> The next mesh for a solution with the values `u` at the nodes of `mesh`, which the new mesh replaces. `norm` is 'l2'
  !> or 'h1'; `more` has further members of the spec, such as the domain of the mesh: '"domain": {...}'.
  subroutine equimesh_round(service, u, mesh, error, norm, more)
    type(equimesh_service), intent(in) :: service
    real(c_double), intent(in) :: u(:)
    type(equimesh_mesh), intent(inout), target :: mesh
    character(:), allocatable, intent(out) :: error
    character(*), intent(in), optional :: norm, more
    character(:), allocatable :: norm_text, more_text
    type(c_mesh) :: found
    integer(c_int) :: failed
    norm_text = 'l2'
    more_text = ''
    if (present(norm)) norm_text = norm
    if (present(more)) more_text = more
    if (.not. has_size(size(u), mesh, 'u', error)) return
    found = lent(mesh)
    failed = c_round(service%handle, u, norm_text // c_null_char, more_text // c_null_char, found)
    call finish(service, failed, found, mesh, error)
  end subroutine

  !> A sequence with its first mesh.
  subroutine equimesh_begin(service, spec, sequence, mesh, error)
    type(equimesh_service), intent(in) :: service
    character(*), intent(in) :: spec
    type(equimesh_sequence), intent(inout) :: sequence
    type(equimesh_mesh), intent(inout) :: mesh
    character(:), allocatable, intent(out) :: error
    type(c_mesh) :: found
    integer(c_int) :: failed
    failed = c_begin(service%handle, spec // c_null_char, sequence, found)
    call finish(service, failed, found, mesh, error)
  end subroutine

  !> The next mesh of a sequence, adapted to `u` at the nodes of `mesh`, which it replaces. The fields, one in each column
  !> of `fields` by its name, are carried to the new nodes.
  subroutine equimesh_step(service, sequence, u, names, fields, mesh, error)
    type(equimesh_service), intent(in) :: service
    type(equimesh_sequence), intent(inout) :: sequence
    real(c_double), intent(in) :: u(:)
    character(*), intent(in) :: names(:)
    real(c_double), intent(inout), target, contiguous :: fields(:, :)
    type(equimesh_mesh), intent(inout), target :: mesh
    character(:), allocatable, intent(out) :: error
    character(len(names) + 1), target :: texts(size(names))
    type(c_ptr) :: name_at(size(names)), field_at(size(names))
    type(c_mesh) :: found
    integer(c_int) :: failed
    integer :: k
    if (.not. has_size(size(u), mesh, 'u', error)) return
    if (.not. has_size(size(fields, 1), mesh, 'a field', error)) return
    do k = 1, size(names)
      texts(k) = trim(names(k)) // c_null_char
      name_at(k) = c_loc(texts(k))
      field_at(k) = c_loc(fields(1, k))
    end do
    found = lent(mesh)
    failed = c_step(service%handle, sequence, u, int(size(names), c_int), name_at, field_at, found)
    call finish(service, failed, found, mesh, error)
  end subroutine

  !> Delete the sequence and its meshes at the service.
  subroutine equimesh_end(service, sequence, error)
    type(equimesh_service), intent(in) :: service
    type(equimesh_sequence), intent(inout) :: sequence
    character(:), allocatable, intent(out) :: error
    if (c_end(service%handle, sequence) /= 0) error = sentence(service)
  end subroutine

  !> Whether an array has a value for each node; else `error` says what is wrong.
  logical function has_size(length, mesh, name, error)
    integer, intent(in) :: length
    type(equimesh_mesh), intent(in) :: mesh
    character(*), intent(in) :: name
    character(:), allocatable, intent(out) :: error
    character(24) :: wanted
    has_size = allocated(mesh%x)
    if (has_size) has_size = length == size(mesh%x)
    if (has_size) return
    write (wanted, '(i0)') merge(size(mesh%x), 0, allocated(mesh%x))
    error = name // ' needs one value for each node of the mesh: ' // trim(wanted)
  end function

  !> A copy of the mesh of Fortran in memory of C, which the client for C may free.
  type(c_mesh) function lent(mesh) result(copy)
    type(equimesh_mesh), intent(in) :: mesh
    interface
      function c_malloc(bytes) bind(c, name='malloc') result(memory)
        import :: c_ptr, c_size_t
        integer(c_size_t), value :: bytes
        type(c_ptr) :: memory
      end function
    end interface
    real(c_double), pointer :: x(:), y(:)
    if (.not. allocated(mesh%x)) return
    copy%points = size(mesh%x)
    copy%n_xi = mesh%n_xi
    copy%n_eta = mesh%n_eta
    copy%x = c_malloc(int(8 * copy%points, c_size_t))
    copy%y = c_malloc(int(8 * copy%points, c_size_t))
    call c_f_pointer(copy%x, x, [copy%points])
    call c_f_pointer(copy%y, y, [copy%points])
    x = mesh%x
    y = mesh%y
  end function

  !> Take the mesh over from C where the call did not fail, and release its memory.
  subroutine finish(service, failed, found, mesh, error)
    type(equimesh_service), intent(in) :: service
    integer(c_int), intent(in) :: failed
    type(c_mesh), intent(inout) :: found
    type(equimesh_mesh), intent(inout) :: mesh
    character(:), allocatable, intent(out) :: error
    real(c_double), pointer :: values(:)
    integer(c_int64_t), pointer :: cells(:, :)
    if (failed /= 0) then
      error = sentence(service)
      call c_free(found)
      return
    end if
    mesh%n_xi = found%n_xi
    mesh%n_eta = found%n_eta
    call c_f_pointer(found%x, values, [found%points])
    mesh%x = values
    call c_f_pointer(found%y, values, [found%points])
    mesh%y = values
    if (allocated(mesh%u)) deallocate (mesh%u)
    if (c_associated(found%u)) then
      call c_f_pointer(found%u, values, [found%points])
      mesh%u = values
    end if
    call c_f_pointer(found%cell, cells, [found%corners, found%cells])
    mesh%cells = cells + 1
    call c_free(found)
  end subroutine

  function sentence(service) result(text)
    type(equimesh_service), intent(in) :: service
    character(:), allocatable :: text
    character(kind=c_char), pointer :: letters(:)
    type(c_ptr) :: at
    integer :: k
    at = c_error(service%handle)
    call c_f_pointer(at, letters, [c_length(at)])
    allocate (character(size(letters)) :: text)
    do k = 1, size(letters)
      text(k:k) = letters(k)
    end do
  end function

end module

//! Objects in memory that the caller owns: words that hold a mark and the core's value.

use crate::result::{SHERKIT_NOT_INITIALISED, SHERKIT_NULL, sherkit_result};
use core::mem::{align_of, size_of};

/// An opaque object of C.
///
/// # Safety
/// It must be `repr(C)` and consist of one array of `WORDS` words.
pub unsafe trait Opaque: Sized {
    /// What it holds.
    type Value: Copy;
    /// First word of an object that has been initialised; another one for each kind.
    const MARK: u64;
    /// Words that it consists of.
    const WORDS: usize;
    /// Fails to compile where the value does not fit.
    const FITS: () = {
        assert!(size_of::<Self>() == 8 * Self::WORDS);
        assert!(size_of::<Self::Value>() + 8 <= size_of::<Self>());
        assert!(align_of::<Self::Value>() <= align_of::<Self>());
        assert!(align_of::<Self>() <= 8);
    };
}

/// Says what an object of C holds: its type, the core's, the mark, the words.
macro_rules! opaque {
    ($object:ty, $value:ty, $mark:literal, $words:literal) => {
        // SAFETY: `repr(C)`, one array of so many words.
        unsafe impl $crate::storage::Opaque for $object {
            type Value = $value;
            const MARK: u64 = $mark;
            const WORDS: usize = $words;
        }
    };
}
pub(crate) use opaque;

fn mark<T: Opaque>(object: *const T) -> *const u64 {
    object.cast()
}

fn place<T: Opaque>(object: *const T) -> *const T::Value {
    object.cast::<u64>().wrapping_add(1).cast()
}

/// Puts a value into an object.
///
/// # Safety
/// The pointer is null or points to an object that nobody else uses.
pub unsafe fn put<T: Opaque>(object: *mut T, value: T::Value) -> Result<(), sherkit_result> {
    const { T::FITS };
    if object.is_null() {
        return Err(SHERKIT_NULL);
    }
    // SAFETY: the object is the caller's, and mark and value fit into it.
    unsafe {
        place(object).cast_mut().write(value);
        mark(object).cast_mut().write(T::MARK);
    }
    Ok(())
}

/// Marks an object as none.
///
/// # Safety
/// As [`put`].
pub unsafe fn clear<T: Opaque>(object: *mut T) {
    if !object.is_null() {
        // SAFETY: as above.
        unsafe { mark(object).cast_mut().write(0) };
    }
}

/// Puts what `make` gives into an object; where it gives nothing the object is none.
///
/// # Safety
/// As [`put`].
pub unsafe fn init<T: Opaque>(
    object: *mut T,
    make: impl FnOnce() -> Result<T::Value, sherkit_result>,
) -> Result<(), sherkit_result> {
    // SAFETY: the caller's word.
    unsafe {
        clear(object);
        put(object, make()?)
    }
}

/// The value of an object.
///
/// # Safety
/// The pointer is null or points to an object that nobody else writes.
pub unsafe fn get<'a, T: Opaque>(object: *const T) -> Result<&'a T::Value, sherkit_result> {
    if object.is_null() {
        return Err(SHERKIT_NULL);
    }
    // SAFETY: an object has a first word; a value follows it where it is the mark.
    unsafe {
        if mark(object).read() != T::MARK {
            return Err(SHERKIT_NOT_INITIALISED);
        }
        Ok(&*place(object))
    }
}

/// The value of an object, to be changed.
///
/// # Safety
/// The pointer is null or points to an object that nobody else uses.
pub unsafe fn get_mut<'a, T: Opaque>(object: *mut T) -> Result<&'a mut T::Value, sherkit_result> {
    if object.is_null() {
        return Err(SHERKIT_NULL);
    }
    // SAFETY: as above.
    unsafe {
        if mark(object).read() != T::MARK {
            return Err(SHERKIT_NOT_INITIALISED);
        }
        Ok(&mut *place(object).cast_mut())
    }
}

/// What a pointer points to.
///
/// # Safety
/// The pointer is null or valid.
pub unsafe fn given<'a, T>(pointer: *const T) -> Result<&'a T, sherkit_result> {
    // SAFETY: the caller's word.
    unsafe { pointer.as_ref() }.ok_or(SHERKIT_NULL)
}

/// Where a pointer points to, for writing.
///
/// # Safety
/// The pointer is null or valid, and nobody else uses what it points to.
pub unsafe fn wanted<'a, T>(pointer: *mut T) -> Result<&'a mut T, sherkit_result> {
    // SAFETY: the caller's word.
    unsafe { pointer.as_mut() }.ok_or(SHERKIT_NULL)
}
